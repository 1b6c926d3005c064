// The live image with everything drawn over it, in pixels of the rectified left image.

import { GOAL, PHASES, SEEN_TOOL, TOOL, confidenceColour, runsOf } from "./colours.js";
import { crossingWords, middle } from "./places.js";
import { threadOf } from "./unpacked.js";

const WAY_S = 6;
const OLD_MS = 1500; // such a thread may lie elsewhere by now
const PREVIEW_MS = 40;

export class Picture {
  constructor(canvas, shown) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.shown = shown;
    this.bitmap = null;
    this.header = null; // of the bitmap
    this.drawn = null; // of the picture that the canvas shows
    this.thread = null;
    this.tools = [];
    this.observed = null;
    this.plan = null;
    this.goal = null;
    this.hover = null;
    this.quiet = false; // nothing is previewed, and little painted, while an arm is armed
    this.alternatives = true;
    this.observations = false;
    this.pending = false;
    this.latest = null;
    this.runs = [];
  }

  async take(header, blob) {
    if ("thread" in header) {
      this.thread = threadOf(header.thread);
      this.runs = this.thread ? runsOf(this.thread) : [];
    }
    if ("observed" in header) this.observed = header.observed;
    this.tools = header.tools;
    try {
      const bitmap = await createImageBitmap(blob);
      this.bitmap?.close();
      [this.bitmap, this.header] = [bitmap, header];
    } catch { /* a picture that is none is not shown, and the next one comes */ }
    this.draw(header);
  }

  // draw at the next turn of the screen; a picture that is shown by it is told
  draw(header = null) {
    if (header) this.latest = header;
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.paint();
      if (this.latest) this.shown(this.latest);
      this.latest = null;
      if (this.moving()) setTimeout(() => this.draw(), PREVIEW_MS);
    });
  }

  moving() {
    return Boolean(this.plan?.way.length) && !document.hidden && !this.quiet;
  }

  scale() {
    return this.header ? this.canvas.width / this.header.width : 1;
  }

  // a place on the page as a pixel of the image
  pixelAt(event) {
    const box = this.canvas.getBoundingClientRect();
    if (!this.header) return null;
    return [(event.clientX - box.left) * this.header.width / box.width - 0.5, (event.clientY - box.top) * this.header.height / box.height - 0.5];
  }

  nearest(pixel) {
    const { px } = this.thread ?? { px: [] };
    let best = null;
    for (let i = 0; i < px.length; i++) {
      const off = Math.hypot(px[i][0] - pixel[0], px[i][1] - pixel[1]);
      if (!best || off < best.off) best = { i, off };
    }
    return best;
  }

  paint() {
    const { canvas, context: c } = this;
    const box = canvas.getBoundingClientRect();
    if (this.header) canvas.style.aspectRatio = `${this.header.width} / ${this.header.height}`;
    const dense = Math.min(2, devicePixelRatio || 1);
    const [width, height] = [Math.round(box.width * dense), Math.round(box.height * dense)];
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = "#000";
    c.fillRect(0, 0, width, height);
    if (!this.bitmap || !this.header) return;
    c.drawImage(this.bitmap, 0, 0, width, height);
    this.drawn = this.header;
    const s = this.scale();
    c.setTransform(s, 0, 0, s, 0.5 * s, 0.5 * s);
    this.thin = dense / s;
    c.lineCap = "round";
    c.lineJoin = "round";
    if (this.thread) this.paintThread();
    if (this.observations && this.observed) this.paintObserved();
    if (this.plan) this.paintPlan();
    for (const tool of this.tools) this.paintTool(tool);
    if (this.goal?.at) this.paintGoal(this.goal.at, "goal");
    else if (this.goal?.exit) this.paintGoal(this.goal.exit, "exit");
    if (this.hover) this.paintGoal(this.hover, "");
  }

  line(points, colour, width, dash = [], halo = "#000b") {
    if (points.length < 2) return;
    const c = this.context;
    c.beginPath();
    points.forEach(([u, v], i) => (i ? c.lineTo(u, v) : c.moveTo(u, v)));
    c.setLineDash(dash.map((d) => d * this.thin));
    if (halo) {
      c.strokeStyle = halo;
      c.lineWidth = (width + 2.5) * this.thin;
      c.stroke();
    }
    c.strokeStyle = colour;
    c.lineWidth = width * this.thin;
    c.stroke();
    c.setLineDash([]);
  }
  // milliseconds between the thread's frame and the one that is shown
  older() { return this.header.capture_ms - this.thread.capture_ms; }

  isOld() { return Boolean(this.thread) && this.older() > OLD_MS; }

  paintThread() {
    const { px, confidence, crossings } = this.thread;
    if (this.isOld()) this.text(`thread of ${(this.older() / 1000).toFixed(0)} s ago`, px[px.length >> 1], 22, "#fff", 13);
    this.context.globalAlpha = this.isOld() ? 0.45 : 1;
    for (const run of this.runs) {
      const places = px.slice(run.begin, run.end + 1);
      const middle = confidence[(run.begin + run.end) >> 1];
      const halo = run.kind.name === "unsure" ? "#ffffffd0" : "#000b"; // dark on a light edge, light on a dark one
      this.line(places, confidenceColour(run.kind.sample === null ? null : middle), run.kind.width, run.kind.dash, halo);
    }
    const c = this.context;
    for (const crossing of crossings) {
      c.beginPath();
      c.arc(...crossing.px, 9 * this.thin, 0, 2 * Math.PI);
      c.strokeStyle = "#fff";
      c.lineWidth = 1.6 * this.thin;
      c.stroke();
      this.text(crossingWords(crossing), crossing.px, 13, "#fff", 11);
    }
    for (const [from, to] of this.thread.elsewhere) {
      const leads = [this.placeOf(from), this.placeOf(to)];
      this.line(leads, "#ffbe3c", 2.5, [8, 5], "#000b");
      this.text("may lead so", [0, 1].map((k) => (leads[0][k] + leads[1][k]) / 2), 13, "#ffbe3c", 11);
    }
    c.globalAlpha = 1;
    this.text("s = 0", px[0], 8, "#fff", 12);
    this.text("s = 1", px.at(-1), 8, "#fff", 12);
  }

  paintObserved() {
    const c = this.context;
    c.fillStyle = "#fff";
    c.strokeStyle = "#000";
    for (const [places, radius] of [[this.observed.centreline, 1.7], [this.observed.px, 3.5]]) for (const [u, v] of places) {
      c.beginPath();
      c.arc(u, v, radius * this.thin, 0, 2 * Math.PI);
      c.fill();
      c.lineWidth = this.thin;
      c.stroke();
    }
  }

  placeOf(s) {
    const { px } = this.thread;
    const at = Math.max(0, Math.min(1, s)) * (px.length - 1);
    const i = Math.min(px.length - 2, Math.floor(at));
    return [0, 1].map((k) => px[i][k] + (at - i) * (px[i + 1][k] - px[i][k]));
  }

  paintPlan() {
    const { way, alternatives, ok, s_capture: capture } = this.plan;
    const c = this.context;
    if (this.alternatives && this.thread) {
      for (const each of alternatives) {
        const [u, v] = this.placeOf(each.s);
        c.beginPath();
        c.arc(u, v, (2 + 4 * each.probability) * this.thin, 0, 2 * Math.PI);
        c.fillStyle = !each.possible ? "#0008" : confidenceColour(each.probability);
        c.fill();
        c.strokeStyle = "#fff";
        c.lineWidth = this.thin;
        c.stroke();
      }
    }
    if (!ok || !way.length) return;
    for (let i = 0; i + 1 < way.length; i++) {
      if (way[i].px.length && way[i + 1].px.length)
        this.line([middle(way[i].px), middle(way[i + 1].px)], PHASES[way[i + 1].phase], 2, [], i % 8 ? null : "#0006");
    }
    if (capture !== null && this.thread && Math.abs(capture - this.plan.s_goal) > 0.03) this.text("capture", this.placeOf(capture), 16, PHASES.capture, 12);
    const pose = this.previewed();
    if (pose?.px.length) this.line(pose.px, PHASES[pose.phase], 5);
    if (pose) this.text(`preview: ${pose.phase}`, middle(pose.px), 26, PHASES[pose.phase], 13);
  }

  previewed() {
    const way = this.plan?.way ?? [];
    if (!way.length || this.quiet) return null;
    const at = (performance.now() / 1000 / WAY_S) % 1.15;
    return way[Math.min(way.length - 1, Math.floor(at * way.length))];
  }

  paintTool(tool) {
    if (tool.outline?.length) {
      const c = this.context;
      c.fillStyle = SEEN_TOOL;
      for (const [u, v] of tool.outline) c.fillRect(u - this.thin, v - this.thin, 2 * this.thin, 2 * this.thin);
    }
    if (!tool.px.length) return;
    this.line(tool.shaft, "#8d93a3", 7);
    this.line(tool.px, TOOL, 4);
    const off = tool.off_mm === undefined ? "" : `, ${tool.off_mm.toFixed(1)} mm off its registration`;
    this.text(`${tool.arm} ${tool.mode}${off}`, tool.px[1], 50, TOOL, 12);
  }

  paintGoal(at, words) {
    const c = this.context;
    c.lineWidth = 2 * this.thin;
    for (const [colour, radius] of [["#000", 11.5], [GOAL, 10]]) {
      c.strokeStyle = colour;
      c.beginPath();
      c.arc(...at.px, radius * this.thin, 0, 2 * Math.PI);
      c.stroke();
    }
    this.line([[at.px[0] - 16 * this.thin, at.px[1]], [at.px[0] + 16 * this.thin, at.px[1]]], GOAL, 1.5);
    this.line([[at.px[0], at.px[1] - 16 * this.thin], [at.px[0], at.px[1] + 16 * this.thin]], GOAL, 1.5);
    if (words) this.text(words, at.px, -20, GOAL, 13);
  }

  text(words, [u, v], off, colour, size) {
    const c = this.context;
    c.font = `600 ${size * this.thin}px system-ui, sans-serif`;
    c.lineWidth = 3 * this.thin;
    c.strokeStyle = "#000c";
    // beside its place, on the side where there is room
    const wide = c.measureText(words).width;
    const room = u + 10 * this.thin + wide < this.header.width;
    const [x, y] = [room ? u + 10 * this.thin : u - 10 * this.thin - wide, v + off * this.thin];
    c.strokeText(words, x, y);
    c.fillStyle = colour;
    c.fillText(words, x, y);
  }
}
