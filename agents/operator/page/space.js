// Thread, way of the jaw, tool and tissue in space, turned by hand; millimetres in the left camera's frame.

import { PHASES, TOOL, confidenceColour, runsOf } from "./colours.js";
import { middle } from "./places.js";

export class Space {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.turn = [0.5, 0.45];
    this.zoom = 1;
    this.surface = [];
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); this.pointers.set(e.pointerId, e); });
    canvas.addEventListener("pointermove", (e) => this.moved(e));
    for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoomed(Math.exp(-e.deltaY / 500)); }, { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
  }

  moved(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    if (this.pointers.size === 2) {
      const other = [...this.pointers.values()].find((p) => p.pointerId !== event.pointerId);
      const apart = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
      this.zoomed(apart(event) / Math.max(1, apart(before)));
    } else {
      this.turned((event.clientX - before.clientX) / 150, (event.clientY - before.clientY) / 150);
    }
    this.pointers.set(event.pointerId, event);
  }

  key(event) {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (turns[event.key]) this.turned(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoomed(1.15);
    else if (event.key === "-") this.zoomed(1 / 1.15);
    else return;
    event.preventDefault();
  }

  turned(yaw, pitch) { this.turn = [this.turn[0] + yaw, Math.max(-1.5, Math.min(1.5, this.turn[1] + pitch))]; }
  zoomed(by) { this.zoom = Math.max(0.3, Math.min(6, this.zoom * by)); }

  paint(picture) {
    const { canvas, context: c } = this;
    const dense = Math.min(2, devicePixelRatio || 1);
    const box = canvas.getBoundingClientRect();
    const [width, height] = [Math.round(box.width * dense), Math.round(box.height * dense)];
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    c.fillStyle = "#3c3c44";
    c.fillRect(0, 0, width, height);
    const { thread, plan, tools } = picture;
    if (!thread) return this.word("no thread to show", width, height, dense);
    this.look(thread.mm, width, height);
    this.tissue(dense);
    c.lineCap = "round";
    for (const run of runsOf(thread)) {
      const confidence = run.kind.sample === null ? null : thread.confidence[(run.begin + run.end) >> 1];
      const places = thread.mm.slice(run.begin, run.end + 1);
      if (run.kind.name === "unsure") this.line(places, "#ffffffb0", run.kind.width * dense * 1.3, run.kind.dash);
      this.line(places, confidenceColour(confidence), run.kind.width * dense * 0.8, run.kind.dash);
    }
    const way = plan?.way ?? [];
    for (let i = 0; i + 1 < way.length; i++)
      if (way[i].mm.length && way[i + 1].mm.length) this.line([middle(way[i].mm), middle(way[i + 1].mm)], PHASES[way[i + 1].phase], 2 * dense);
    const pose = picture.previewed();
    if (pose?.mm.length) this.line(pose.mm, PHASES[pose.phase], 4 * dense);
    for (const tool of tools) if (tool.mm.length) this.line(tool.mm, TOOL, 3.5 * dense);
    this.bar(thread, width, height, dense);
  }

  look(points, width, height) {
    const centre = [0, 1, 2].map((k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
    const reach = Math.max(...points.map((p) => Math.hypot(...p.map((v, k) => v - centre[k])))) || 1;
    const [a, b] = this.turn;
    const per = 0.42 * Math.min(width, height) * this.zoom / reach;
    this.per = per;
    this.at = (p) => {
      const [x, y, z] = p.map((v, k) => v - centre[k]);
      const right = x * Math.cos(a) + z * Math.sin(a);
      const away = -x * Math.sin(a) + z * Math.cos(a);
      return [width / 2 + per * right, height / 2 + per * (y * Math.cos(b) - away * Math.sin(b)), away * Math.cos(b) + y * Math.sin(b)];
    };
    this.reach = reach;
  }

  tissue(dense) {
    const c = this.context;
    for (const point of this.surface) {
      const [u, v, away] = this.at(point);
      const light = Math.max(85, Math.min(165, 125 - 40 * away / this.reach));
      c.fillStyle = `rgb(${light + 22},${light},${light})`;
      c.fillRect(u, v, 2 * dense, 2 * dense);
    }
  }

  line(points, colour, width, dash = []) {
    const c = this.context;
    c.beginPath();
    points.forEach((p, i) => { const [u, v] = this.at(p); if (i) c.lineTo(u, v); else c.moveTo(u, v); });
    c.setLineDash(dash);
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.stroke();
    c.setLineDash([]);
  }

  bar(thread, width, height, dense) {
    if (!thread.unit_known) return this.word("in the calibration's own unit", width, height, dense);
    const c = this.context;
    const [x, y] = [14 * dense, height - 14 * dense];
    c.strokeStyle = c.fillStyle = "#ddd";
    c.lineWidth = 2 * dense;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(x + 10 * this.per, y);
    c.stroke();
    c.font = `${12 * dense}px system-ui, sans-serif`;
    c.fillText("10 mm", x, y - 6 * dense);
  }

  word(words, width, height, dense) {
    const c = this.context;
    c.fillStyle = "#bbb";
    c.font = `${13 * dense}px system-ui, sans-serif`;
    c.fillText(words, 14 * dense, height - 14 * dense);
  }
}
