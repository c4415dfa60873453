// The solutions that a run or a unit is part of, as a line of links; empty without one.

import { get, serviceError } from "./api.js";
import { fill, h } from "./dom.js";
import { moment } from "./format.js";

const LISTED = 5;

/** Of a run on its rig, or of a unit, newest first. */
export function solutionLinks({ rig, run, unit }, signal) {
  const element = h("span", { class: "solutions", hidden: true });
  const isIn = ({ runs, units }) => (run ? runs.includes(run) : units.includes(unit));
  const show = async () => {
    try {
      const all = await get(`/api/solve?${new URLSearchParams(rig ? { rig } : {})}`, signal);
      const found = all.filter(isIn).slice(0, LISTED);
      element.hidden = !found.length;
      const link = ({ id, created_at: at }, k) => [k > 0 && ", ", h("a", { href: `#/solve/${id}` }, moment(at))];
      fill(element, found.length > 0 && "In solutions of ", found.map(link));
    } catch (problem) {
      if (problem.name !== "AbortError") serviceError(problem, signal); // the banner reports a lost service
    }
  };
  show();
  return element;
}
