// The position of a stage without homing, entered by the user who starts or resumes a run.

import { get } from "./api.js";
import { field, fill, h, runName, unfold } from "./dom.js";

const ASKED_FOR = "--stage-at"; // in the error of a run that needs the position

/** The field; `value()` is the elevation or null, `put(value)` sets it. */
export function placeField() {
  const input = h("input", {
    id: "stage_at_deg",
    type: "number",
    step: "any",
    min: "-360",
    max: "360",
    placeholder: "as stored",
  });
  return {
    element: field("stage_at_deg", "The stage stands at, °", input),
    value: () => (input.value === "" ? null : Number(input.value)),
    put: (value) => (input.value = value ?? ""),
  };
}

/** The field; `look()` unfolds it if the last run on `rigName()` failed without it. */
export function stagePlace(rigName, signal) {
  const place = placeField();
  const why = h("p", { id: "stage-at-why", class: "muted" });
  const element = h("div", { id: "stage-place" }, place.element, why);

  async function look() {
    const rig = rigName();
    const query = new URLSearchParams({ rig, limit: 1 });
    const { items } = await get(`/api/runs?${query}`, signal);
    if (rig !== rigName()) return;
    const [last] = items;
    const isAskedFor = Boolean(last?.error?.includes(ASKED_FOR));
    if (isAskedFor) unfold(element);
    fill(
      why,
      isAskedFor
        ? `The last run on this rig, ${runName(last.id)}, needs the position: ${last.error}`
        : "Only for a stage without homing that was rotated by hand or has lost its position.",
    );
  }

  return { element, look, value: place.value };
}
