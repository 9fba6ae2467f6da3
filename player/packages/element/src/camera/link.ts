/** Links with a time and a view: `#t=1.25&view=` eye, rotation wxyz and pivot distance, separated by commas. */
import { normalized } from "../base/quaternion";
import type { Start } from "./pose";

/** Return an address with a time and a view. */
export function linkTo(address: string, { seconds, view }: Start): string {
  const parts = [];
  if (seconds !== null) parts.push(`t=${round(seconds, 3)}`);
  if (view) parts.push(`view=${[...view.eye, ...view.turn, view.distance].map((value) => round(value, 4)).join(",")}`);
  return `${address.split("#")[0]}#${parts.join("&")}`;
}

/** Parse the time and view of an address. Invalid parts are null. */
export function startOf(address: string): Start {
  const parameters = new URLSearchParams(address.split("#")[1] ?? "");
  const seconds = Number.parseFloat(parameters.get("t") ?? "");
  const numbers = (parameters.get("view") ?? "").split(",").map(Number);
  const readable =
    numbers.length === 8 &&
    numbers.every(Number.isFinite) &&
    numbers[7] > 0 &&
    Math.hypot(...numbers.slice(3, 7)) > 0.5;
  const [x, y, z, a, b, c, d, distance] = numbers;
  return {
    seconds: Number.isFinite(seconds) ? seconds : null,
    view: readable ? { eye: [x, y, z], turn: normalized([a, b, c, d]), distance } : null,
  };
}

function round(value: number, digits: number): string {
  return String(Number(value.toFixed(digits)));
}
