/** Draws the box and the marks of an edit over the picture, with a handle on each face of the box. */
import { add, cross, eyeOf, length, scale, subtract, type Vec3 } from "@splatreel/decoder/internal";
import type { Sphere, View } from "@splatreel/renderer";
import type { Words } from "../base/words";
import { edgesOf, FACES, middleOf, projected, type Box, type Face } from "./crop-box";
import { lineOf } from "./path-drawing";

const SVG = "http://www.w3.org/2000/svg";
/** Radius of a handle in pixels, and points of a circle. */
const HANDLE = 9;
const CIRCLE = 32;

/** SVG overlay of an edit. */
export class EditDrawing {
  readonly box = document.createElementNS(SVG, "svg");
  private readonly lines: SVGPathElement[];
  private readonly handles: SVGCircleElement[];

  /** t: texts. drag: called with a face and the pixels by which its handle was dragged. */
  constructor(
    private readonly t: Words,
    drag: (face: Face, by: [number, number]) => void,
  ) {
    this.box.classList.add("path-drawing", "edit-drawing");
    this.lines = ["under", "curve", "under", "marks"].map((name) => {
      const path = document.createElementNS(SVG, "path");
      path.classList.add(name);
      return path;
    });
    this.handles = FACES.map((face) => this.handle(face, drag));
    this.box.append(...this.lines, ...this.handles);
  }

  /** Draw a box, or none, and marks. */
  draw(box: Box | null, marks: Sphere[], view: View): void {
    this.box.setAttribute("viewBox", `0 0 ${view.width} ${view.height}`);
    const edges = box
      ? edgesOf(box)
          .map((edge) => lineOf(edge, view))
          .join("")
      : "";
    const circles = marks.map((mark) => lineOf(outline(mark, view), view)).join("");
    for (const [i, shape] of [edges, edges, circles, circles].entries()) this.lines[i].setAttribute("d", shape);
    for (const [i, face] of FACES.entries()) {
      const place = box && projected(middleOf(box, face), view);
      this.handles[i].style.display = place ? "" : "none";
      this.handles[i].setAttribute("cx", String(place?.[0] ?? 0));
      this.handles[i].setAttribute("cy", String(place?.[1] ?? 0));
    }
  }

  private handle(face: Face, drag: (face: Face, by: [number, number]) => void): SVGCircleElement {
    const circle = document.createElementNS(SVG, "circle");
    circle.setAttribute("r", String(HANDLE));
    circle.setAttribute("role", "slider");
    circle.setAttribute("tabindex", "0");
    circle.setAttribute(
      "aria-label",
      this.t(face.side === 0 ? "Face of the box: low {0}" : "Face of the box: high {0}", "xyz"[face.axis]),
    );
    let last: [number, number] | null = null;
    circle.onpointerdown = (event) => {
      circle.setPointerCapture(event.pointerId);
      last = [event.clientX, event.clientY];
      event.stopPropagation();
    };
    circle.onpointermove = (event) => {
      if (!last) return;
      const scale = this.box.getBoundingClientRect().width / this.box.viewBox.baseVal.width || 1;
      drag(face, [(event.clientX - last[0]) / scale, (event.clientY - last[1]) / scale]);
      last = [event.clientX, event.clientY];
    };
    circle.onpointerup = circle.onpointercancel = () => void (last = null);
    circle.onkeydown = (event) => {
      const by = { ArrowLeft: [-4, 0], ArrowRight: [4, 0], ArrowUp: [0, -4], ArrowDown: [0, 4] }[event.key];
      if (!by || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      event.stopPropagation();
      drag(face, by as [number, number]);
    };
    return circle;
  }
}

/** Return the outline of a sphere as the viewer sees it. */
function outline({ center, radius }: Sphere, { viewmat: m }: View): Vec3[] {
  const away = subtract(center, eyeOf(m));
  const down = cross(away, [m[0], m[1], m[2]]);
  const across = scale(down, 1 / Math.max(length(down), 1e-12));
  const side = cross(across, away);
  const beside = scale(side, 1 / Math.max(length(side), 1e-12));
  return Array.from({ length: CIRCLE + 1 }, (_, i) => {
    const angle = (2 * Math.PI * i) / CIRCLE;
    return add(center, add(scale(beside, radius * Math.cos(angle)), scale(across, radius * Math.sin(angle))));
  });
}
