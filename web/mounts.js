// The plan's fields for the mounting angles and axis of the unit.

import { field, h, select } from "./dom.js";

const PRESETS = ["0", "0, 120, 240", "0, 51.43, 154.29"];
const AXES = ["x", "y", "z", "-x", "-y", "-z"];

/** The fields; `value()` is their part of the plan, `set(plan)` fills them from a plan. */
export function mountFields() {
  const angles = h("input", { id: "mounts_deg", type: "text", list: "mounts-usual", value: "0", required: true });
  const usual = h("datalist", { id: "mounts-usual" }, PRESETS.map((value) => h("option", { value })));
  const axis = select({ id: "mount_axis" }, AXES.map((value) => [value, value.replace("-", "−")]));

  function set({ mounts_deg: mounts, mount_axis: along }) {
    if (mounts) angles.value = mounts.join(", ");
    if (AXES.includes(along)) axis.value = along;
  }

  const element = h(
    "div",
    { class: "fields two" },
    h("div", { class: "field" }, h("label", { for: "mounts_deg" }, "Mounting angles, °"), angles, usual),
    field("mount_axis", "Unit axis along stage axis", axis),
  );
  return { element, set, value: () => ({ mounts_deg: numbers(angles.value), mount_axis: axis.value }) };
}

/** "−60, 0; 60.5" as numbers; a word that is no number stays a word, and the service refuses it by name. */
export function numbers(text) {
  const words = text
    .replaceAll("−", "-")
    .split(/[\s,;]+/)
    .filter(Boolean);
  return words.map((word) => (Number.isFinite(Number(word)) ? Number(word) : word));
}
