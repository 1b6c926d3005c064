import { legend } from "./colours.js";
import { DeadMan } from "./deadman.js";
import { connect } from "./link.js";
import { Panel } from "./panel.js";
import { Picture } from "./picture.js";
import { whyBlind } from "./sight.js";
import { Space } from "./space.js";

const $ = (id) => document.getElementById(id);
const FRESH_MS = 500;
const STEP = 0.01;
const ASKED_MS = 700;
const presented = [];

let link = { say() {} };
let deadman = null;
let lastPictureMs = 0;
let asked = { s: 0.5, ms: -Infinity };
const plans = {};
const panel = new Panel($);
const picture = new Picture($("picture"), (header) => {
  link.say("shown", { frame: header.frame });
  requestAnimationFrame(() => {
    // the turn after the one that drew it: by now it is on the screen
    presented.push([header.frame, header.capture_ms, nowMs(), header.thread_frame ?? -1]);
    if (presented.length > 2000) presented.shift();
  });
});
const space = new Space($("space"));
window.suturegrasp = { presented, picture, panel, plans };

function nowMs() { return performance.timeOrigin + performance.now(); }
const arm = () => $("arm").value;
const isDone = (plan) => Boolean(plan) && panel.state?.done[plan.arm] === plan.id;
const isBlind = (asked) => whyBlind(picture.drawn, asked);
const currentPlan = () => (plans[arm()]?.ok && !isDone(plans[arm()]) ? plans[arm()] : null);

function refresh() {
  panel.see(arm(), picture.drawn);
  const plan = plans[arm()] ?? null;
  // what was carried out is told, and no longer drawn
  picture.plan = isDone(plan) ? null : plan;
  picture.goal = panel.state?.goals[arm()] ?? null;
  panel.show(plan, isDone(plan), picture.goal, deadman?.down ?? null);
  picture.quiet = Boolean(panel.state?.press);
  picture.draw();
}

link = await connect({
  welcome() { tellLook(); },
  challenge(asked) { deadman?.challenge(asked); },
  picture(header, blob) {
    lastPictureMs = performance.now();
    if ("surface" in header) space.surface = header.surface;
    panel.pictured(header, picture.thread);
    picture.take(header, blob);
  },
  plan({ plan }) { plans[plan.arm] = plan; refresh(); },
  state(state) {
    for (const name of Object.keys(plans)) if (plans[name].id !== state.plan_ids[name]) delete plans[name];
    panel.take(state);
    refresh();
  },
  refused({ text }) { panel.refused(text); deadman?.release("it was refused"); },
  lost() { deadman?.release("the connection was lost"); panel.lost(); },
  shut(text) { panel.shut(text); },
}) ?? link;
deadman = new DeadMan($("press"), link, currentPlan, isBlind);

function tellLook() {
  link.say("look", { observations: $("show-observations").checked, space: $("show-space").checked });
}

legend($("legend"));
for (const id of ["show-observations", "show-space"]) $(id).addEventListener("change", () => {
  picture.observations = $("show-observations").checked;
  $("space-card").hidden = !$("show-space").checked;
  tellLook();
});
$("show-alternatives").addEventListener("change", (e) => { picture.alternatives = e.target.checked; picture.draw(); });
$("arm").addEventListener("change", refresh);
$("hold").addEventListener("click", () => hold());
$("again").addEventListener("click", () => {
  const goal = picture.goal;
  if (goal?.at) place(goal.at.s);
  else if (goal?.tail_mm) pointing("pull");
  else if (goal) letGo();
});
$("pull").addEventListener("click", () => pointing(panel.pointing !== "pull" && $("tail").reportValidity() ? "pull" : ""));
$("let-go").addEventListener("click", letGo);
$("any").addEventListener("click", () => link.say("prompt", { pixel: null }));
$("meant").addEventListener("click", () => pointing(panel.pointing === "meant" ? "" : "meant"));
$("take").addEventListener("click", () => link.say("take"));
$("give").addEventListener("click", () => link.say("give", { yes: true }));
$("keep").addEventListener("click", () => link.say("give", { yes: false }));
$("record").addEventListener("click", () => link.say("record", { on: !panel.state?.recording?.on }));
$("next").addEventListener("click", () => link.say("go_on", { arm: arm() }));
$("held").addEventListener("click", () => judged(true, ""));
$("causes").addEventListener("click", (e) => { const button = e.target.closest("button"); if (button) judged(false, button.dataset.cause); });
$("goal").addEventListener("click", (e) => { if (e.target.dataset.s) place(Number(e.target.dataset.s)); });
$("theme").addEventListener("click", () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
});

$("picture").addEventListener("click", (event) => {
  const pixel = picture.pixelAt(event);
  if (!pixel) return;
  const what = panel.pointing;
  // what was begun stays what a click means until it can be said
  if (what === "pull" && !$("tail").reportValidity()) return;
  if (what) pointing("");
  if (what === "meant") {
    link.say("prompt", { pixel });
  } else if (what === "pull") {
    link.say("pull", { frame: picture.thread?.frame ?? 0, arm: arm(), tail_mm: $("tail").valueAsNumber, exit_pixel: pixel });
  } else {
    link.say("click", { frame: picture.thread?.frame ?? 0, pixel, arm: arm(), policy: $("policy").value });
  }
});
$("picture").addEventListener("pointermove", (event) => {
  const pixel = picture.pixelAt(event);
  const found = pixel && picture.thread ? picture.nearest(pixel) : null;
  picture.hover = found && found.off < 60 ? { px: picture.thread.px[found.i] } : null;
  panel.tip(event, picture.hover ? picture.thread : null, found?.i);
  picture.draw();
});
$("picture").addEventListener("pointerleave", () => { picture.hover = null; panel.tip(null); picture.draw(); });
$("picture").addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -STEP, ArrowRight: STEP, PageDown: -10 * STEP, PageUp: 10 * STEP }[event.key];
  if (!step || !picture.thread) return;
  event.preventDefault();
  // keys that follow each other quickly go on from what was asked for, which the server has not told yet
  const from = performance.now() - asked.ms < ASKED_MS ? asked.s : picture.goal?.at?.s ?? 0.5;
  place(Math.max(0, Math.min(1, from + step)));
});
addEventListener("keydown", (event) => {
  const types = event.target.matches?.("input[type=text]");
  if (event.key === "Escape" || (event.key === " " && !types)) {
    event.preventDefault();
    if (!event.repeat) hold();
  }
}, { capture: true });
// the space bar holds, so it is Enter that ticks a box
addEventListener("keydown", (event) => { if (event.key === "Enter" && event.target.matches?.("input[type=checkbox]")) event.target.click(); });
// a button that has the focus is not to be clicked by the key that holds
addEventListener("keyup", (event) => { if (event.key === " " && !event.target.matches?.("input[type=text]")) event.preventDefault(); }, { capture: true });
addEventListener("resize", () => picture.draw());

function hold() {
  link.say("hold");
  deadman?.release("hold");
}

function place(s) {
  asked = { s, ms: performance.now() };
  link.say("place", { s, arm: arm(), policy: $("policy").value });
}

function letGo() {
  link.say("let_go", { arm: arm() });
}

// the next click on the image says something else than a goal on the thread
function pointing(what) {
  panel.pointing = what;
  for (const id of ["meant", "pull"]) $(id).setAttribute("aria-pressed", String(id === what));
  panel.refused({ meant: "Click the thread that is meant.", pull: "Click where the tail comes out of the tissue." }[what] ?? "");
}

function judged(held, cause) {
  link.say("judged", { held, cause, note: $("note").value });
  $("note").value = "";
}

setInterval(() => {
  if (!$("space-card").hidden && !document.hidden && !picture.quiet) space.paint(picture);
  panel.stale(performance.now() - lastPictureMs > FRESH_MS);
  if (panel.see(arm(), picture.drawn)) refresh();
}, 100);
