// Everything that is said in words.

import { ageMs, seconds, whyBlind } from "./sight.js";

const percent = (value) => (value === null || value === undefined ? "?" : `${Math.round(100 * value)} %`);

const OUT_OF_ORDER = ["fault", "disabled"];
const MODELS = { geometric: ", by geometry", paper: ", as in the paper" };

export class Panel {
  constructor($) {
    this.$ = $;
    this.state = null;
    this.pointing = "";
    this.blind = "";
    this.kept = {};
  }

  // set text or markup only where it changes: screen readers read out what does
  put(id, text, property = "textContent") {
    if (this.kept[id + property] === text) return;
    this.kept[id + property] = text;
    this.$(id)[property] = text;
  }

  take(state) {
    this.state = state;
    this.stateMs = performance.now();
    const $ = this.$;
    const arms = state.arms.map((each) => each.arm);
    if (this.arms !== arms.join()) {
      this.arms = arms.join();
      const before = $("arm").value;
      $("arm").replaceChildren(...arms.map((name) => new Option(name, name, false, name === before)));
    }
    const mine = state.controller === state.you;
    this.put("rig", `of ${state.rig}`);
    this.put("control", mine ? `${state.you}: you control` : `${state.you}: you watch`);
    $("control").className = mine ? "mine" : "";
    this.put("words", state.words[$("arm").value] ?? Object.values(state.words)[0] ?? "No arm is configured.");
    $("words").classList.toggle("grave", state.arms.some((each) => each.arm === $("arm").value && OUT_OF_ORDER.includes(each.mode)));
    this.put("lines", state.lines.toReversed().map((line) => `<li>${escaped(line)}</li>`).join(""), "innerHTML");
    this.put("arms", state.arms.map((each) => `<li><strong>${escaped(each.arm)}</strong> ${escaped(each.words)}</li>`).join(""), "innerHTML");
    this.bad(state);
    this.agents(state.wellbeing);
    this.recording(state.recording);
    this.trials(state);
    this.put("screens", screensSentence(state));
    $("take").hidden = mine || state.asking === state.you;
    $("give").hidden = !(mine && state.asking);
    $("keep").hidden = !(mine && state.asking);
    for (const id of ["again", "meant", "any", "next", "pull", "let-go"]) $(id).disabled = !mine;
  }

  show(plan, done, goal, down) {
    const $ = this.$;
    if (!this.state) return;
    const press = this.state.press;
    const mine = this.state.controller === this.state.you;
    const armed = press && press.stage !== "pressing";
    const name = plan?.arm ?? $("arm").value;
    const ordered = !this.state.arms.some((each) => each.arm === name && OUT_OF_ORDER.includes(each.mode));
    // a press that has begun is let go of by the challenge that must not be answered, which says why
    const blind = this.blind && !down;
    // a further segment is armed with the first one
    $("press").disabled = !mine || !plan?.ok || done || !ordered || blind || (plan.continues && !down);
    $("press").classList.toggle("armed", Boolean(armed && down));
    const offered = ordered && !blind ? `Press and hold to arm ${name}` : `${name} cannot be armed`;
    this.put("press-text", armed && down ? `${name} moves: keep pressing` : down ? "Keep pressing ..." : offered);
    this.put("goal", goalMarkup(plan, done, goal, this.note, this.state.checks[name]), "innerHTML");
  }

  // how old the drawn picture is by the bridge's clock, which has gone on since it was told; whether what is armed by
  // what is seen has changed
  see(name, drawn) {
    const told = this.state?.arms.find((each) => each.arm === name);
    if (!told) return false;
    const now = { ...told, at_ns: told.at_ns === "0" ? "0" : String(BigInt(told.at_ns) + BigInt(Math.round(1e6 * (performance.now() - this.stateMs)))) };
    const age = ageMs(drawn, name, now.at_ns);
    const allowed = told.limit_ms ? `, ${seconds(told.limit_ms)} are allowed` : "";
    this.put("sight", age === null ? `how old the picture is, the bridge of ${name} cannot tell` : `by the bridge of ${name} the picture is ${seconds(Math.max(0, age))} old at most${allowed}`);
    const before = this.blind;
    this.blind = told.real ? whyBlind(drawn, now) : "";
    this.put("blind", this.blind && told.mode ? `${name} cannot be armed: ${this.blind}. See to the camera and its link.` : "");
    return before !== this.blind;
  }

  refused(text) {
    this.note = text;
    this.noteUntil = performance.now() + 8000;
  }

  bad(state) {
    if (this.note && performance.now() > this.noteUntil) this.note = "";
    const told = state.judgements.map((j) => `<p class="${j.severity}"><strong>${j.severity === "fault" ? "Bad input" : "Input"}:</strong> ${escaped(j.finding)}${j.remedy ? `. ${escaped(j.remedy)}` : ""}</p>`);
    this.put("bad", told.join(""), "innerHTML");
  }

  agents(wellbeing) {
    const wrong = wellbeing.wrong ?? [];
    this.put("wrong", wrong.map((w) => `<li class="${w.grave ? "grave" : ""}">${escaped(w.text)}</li>`).join(""), "innerHTML");
    const rows = (wellbeing.agents ?? []).map((a) => `<tr><td>${escaped(a.name)}</td><td>${escaped(a.state)}</td><td>${escaped(a.rates)}</td></tr>`);
    this.put("agents", rows.length ? `<tr><th>agent</th><th>state</th><th>sends, Hz</th></tr>${rows.join("")}` : "", "innerHTML");
  }

  recording(recording) {
    this.put("recording", recording.text ?? "nobody has told yet");
    this.$("recording").className = recording.lacks ? "refused" : "";
    this.$("record").hidden = !recording.can;
    this.put("record", recording.on ? "End the recording" : "Record");
  }

  trials(state) {
    const trials = state.trials;
    this.$("trials").hidden = !trials.text;
    this.put("trials-text", trials.text ?? "");
    this.$("verdict").hidden = !state.to_judge;
    const causes = Object.entries(trials.causes ?? {});
    this.put("causes", causes.map(([cause, words]) => `<button type="button" data-cause="${escaped(cause)}">${escaped(cause)}<small>${escaped(words)}</small></button>`).join(""), "innerHTML");
  }

  pictured(header, thread) {
    const state = this.state;
    const older = thread && header ? Math.round(header.capture_ms - thread.capture_ms) : null;
    const parts = [];
    if (state?.behind_ms !== null && state?.behind_ms !== undefined) parts.push(`image ${state.behind_ms} ms behind capture`);
    if (older !== null) parts.push(`thread ${older} ms older than the image`);
    if (state?.full) parts.push(fullWords(state));
    if (state?.level) parts.push(`pictures are coarser (${state.level} of 5), for link or browser are slow`);
    this.put("latency", parts.join("; "));
  }

  tip(event, thread, i) {
    const tip = this.$("tip");
    tip.hidden = !thread;
    if (!thread) return;
    const s = i / (thread.px.length - 1);
    const known = thread.confidence[i];
    const sure = thread.unseen[i] ? "not seen by both eyes" : known < 0 ? "confidence unknown" : `confidence ${percent(known)}`;
    tip.textContent = `s = ${s.toFixed(2)}, ${(s * thread.length_mm).toFixed(0)} ${thread.unit_known ? "mm" : "units"} along, ${sure}`;
    const box = this.$("frame").getBoundingClientRect();
    const left = event.clientX - box.left;
    tip.style.left = `${left > box.width - 320 ? left - tip.offsetWidth - 14 : left + 18}px`;
    tip.style.top = `${Math.max(4, event.clientY - box.top - 40)}px`;
  }

  stale(is) {
    this.$("stale").hidden = !is;
    if (is) this.put("stale", this.shutText ?? "No new image comes");
  }

  lost() {
    this.shutText = "The connection is lost: this page holds nothing; use suturegrasp hold or the emergency stop. Trying again ...";
    this.put("words", this.shutText);
    this.$("press").disabled = true;
    setTimeout(() => { this.shutText = null; }, 1500);
  }

  shut(text) {
    this.shutText = text;
    this.put("words", text);
    this.put("control", "");
    this.$("press").disabled = true;
  }
}

function screensSentence(state) {
  const others = state.screens.filter((name) => name !== state.you);
  const who = state.controller ? `${state.controller} controls` : "nobody controls";
  const asks = state.asking ? `; ${state.asking} asks for control` : "";
  return `${state.screens.length} connected, ${who}${asks}.${others.length ? ` Others: ${others.join(", ")}.` : ""}`;
}

function goalMarkup(plan, done, goal, note, check) {
  const told = note ? `<p class="refused">${escaped(note)}</p>` : "";
  // a plan of somebody else's goal, which a press would arm, is not told as that of the goal here
  if (plan && !goal?.text && plan.goal_id !== goal?.goal_id) return told + otherMarkup(plan, done);
  if (!goal) return `${told}<p>No goal yet. Click the thread, or focus the image and use the arrow keys.</p>`;
  if (!goal.at) return told + pullMarkup(plan, done, goal);
  const at = goal.at;
  const off = at.off_mm ? ` (${at.off_mm.toFixed(1)} mm from your click)` : "";
  const rows = [
    ["place", `s = ${at.s.toFixed(3)}, ${at.along_mm.toFixed(1)} mm along${off}`],
    ["confidence", at.unseen ? "not seen by both eyes" : percent(at.confidence)],
  ];
  const strands = goal.others.map((o) => `<button type="button" data-s="${o.s}">other strand, s = ${o.s.toFixed(2)}</button>`).join("");
  let success = `<p>${escaped(goal.text)}</p>`;
  if (plan && !goal.text) {
    success = plan.ok ? `<p class="success">${percent(plan.probability)} <small>predicted success${MODELS[plan.model] ?? ""}${done ? "; carried out" : ""}</small></p>` : `<p class="refused">No grasp: ${escaped(plan.reason)}</p>`;
    if (plan.ok) {
      if (plan.attempt > 1) rows.push(["attempt", `${plan.attempt} of ${plan.attempts}, after a miss`]);
      const slide = plan.slide_mm > 0 ? `capture at s = ${plan.s_capture.toFixed(2)}, slide ${plan.slide_mm.toFixed(0)} mm, ` : "";
      rows.push(["plan", `${slide}grasp at s = ${plan.s_goal.toFixed(2)}`]);
      if (plan.clearance_mm !== undefined) rows.push(["tissue", plan.clearance_mm < 0 ? `jaws press ${-plan.clearance_mm} mm in` : `jaws stay ${plan.clearance_mm} mm before it`]);
      if (plan.unchecked) rows.push(["tissue", plan.unchecked]);
      if (plan.thread_mm !== undefined) rows.push(["thread", plan.thread_mm < 0 ? "the instrument touches other thread" : `other thread stays ${plan.thread_mm} mm away`]);
      if (plan.obstructed) rows.push(["thread", plan.obstructed]);
    }
    const able = plan.alternatives.filter((a) => a.possible).sort((a, b) => b.probability - a.probability);
    const unable = plan.alternatives.filter((a) => !a.possible);
    if (able.length + unable.length) rows.push(["considered", consideredWords(able.length, unable.length)]);
    for (const a of [...able, ...unable].slice(0, 3)) rows.push(["", `s = ${a.s.toFixed(2)}: ${a.possible ? percent(a.probability) : a.reason}`]);
  }
  if (check) rows.push(["check", check]);
  const list = rows.map(([name, words]) => `<dt>${name}</dt><dd>${escaped(words)}</dd>`).join("");
  return `${told}${success}<dl>${list}</dl>${strands}`;
}

function otherMarkup(plan, done) {
  const said = plan.ok ? `Planned by another command${done ? ", and carried out" : ""}` : `No plan: ${plan.reason}`;
  const rows = plan.pull ? [["pull", plan.pull]] : plan.ok ? [["success", percent(plan.probability)]] : [];
  if (plan.bounds) rows.push(["armed for", plan.bounds]);
  return `<p>${escaped(said)}</p><dl>${rows.map(([name, words]) => `<dt>${name}</dt><dd>${escaped(words)}</dd>`).join("")}</dl>`;
}

function pullMarkup(plan, done, goal) {
  const rows = [["goal", goal.tail_mm ? `pull until the tail is ${goal.tail_mm} mm long` : "let go of the thread"]];
  let said = `<p>${escaped(goal.text)}</p>`;
  if (plan && !goal.text) {
    said = plan.ok ? `<p class="success"><small>${done ? "carried out" : "planned"}</small></p>` : `<p class="refused">No pull: ${escaped(plan.reason)}</p>`;
    if (plan.ok) rows.push(["plan", plan.pull]);
    if (plan.bounds) rows.push(["armed for", plan.bounds]);
  }
  return `${said}<dl>${rows.map(([name, words]) => `<dt>${name}</dt><dd>${escaped(words)}</dd>`).join("")}</dl>`;
}

function consideredWords(able, unable) {
  const captures = (count) => `${count} other capture${count === 1 ? "" : "s"}`;
  if (!unable) return captures(able);
  return able ? `${captures(able)}, and ${unable} that ${unable === 1 ? "is" : "are"} not possible` : `${captures(unable)}, not possible`;
}

function fullWords(state) {
  const fewer = state.controller === state.you ? "the thread is drawn 10 times a second" : "pictures come 5 times a second";
  return `${fewer}, for the computer that serves this page is busy`;
}

function escaped(text) {
  return String(text).replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);
}
