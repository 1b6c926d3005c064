// The button that arms: pressed and held, by one pointer or by Enter. Each challenge of the server is answered by this
// very code, and only while the page is seen, has the focus, and shows a picture that is new enough; whatever else
// happens lets go. What takes a press away is listened to on the window, before anything else hears of it: a browser
// may tell the end of a press to another element than the button, or not at all.

const HOLDS = ["Escape", " "]; // these hold, and let go by that
const MODIFIERS = ["ctrlKey", "altKey", "metaKey"];

export class DeadMan {
  // plan: what is armed, or null; blind: why a challenge must not be answered by what is drawn, or ""
  constructor(button, link, plan, blind) {
    this.button = button;
    this.link = link;
    this.plan = plan;
    this.blind = blind;
    this.down = null;
    this.by = null; // { key } or { pointer, touch, x, y }
    const on = (kinds, then, target = window) => {
      for (const kind of kinds) target.addEventListener(kind, then, { capture: true });
    };
    const lets_go = (why) => () => this.release(why);
    on(["pointerdown"], (e) => this.pointerDown(e));
    on(["pointermove"], (e) => this.pointerMoved(e));
    on(["pointerup", "mouseup", "touchend"], lets_go("the button was released"));
    on(["pointercancel", "touchcancel"], lets_go("the touch was cancelled"));
    on(["lostpointercapture"], lets_go("the button was released"));
    on(["mousedown"], (e) => {
      // by itself a browser would give the focus to something else (Safari), or begin to drag or to mark text
      if (this.button.contains(e.target)) e.preventDefault();
      if (e.button !== 0) this.release("another mouse button was pressed");
    });
    on(["dragstart"], lets_go("something was dragged"));
    on(["contextmenu"], (e) => {
      if (!this.down && !this.button.contains(e.target)) return;
      e.preventDefault();
      // a finger that rests on the button asks for a menu too, which does not come
      if (!this.by?.touch) this.release("a menu was asked for");
    });
    on(["keydown"], (e) => this.keyDown(e));
    on(["keyup"], (e) => this.release(e.code === this.by?.key ? "the key was released" : "another key was released"));
    on(["blur"], (e) => {
      if (e.target === this.button) this.release("the button lost the focus");
      else if (e.target === window || e.target === document) this.release("the page lost the focus");
    });
    on(["visibilitychange"], () => { if (document.hidden) this.release("the page was hidden"); }, document);
    on(["freeze"], lets_go("the page was frozen"), document);
    on(["pagehide", "beforeunload"], lets_go("the page was left"));
    on(["beforeprint"], lets_go("the page is to be printed"));
  }

  pointerDown(e) {
    if (this.down) return this.release("a second pointer was pressed");
    if (!this.button.contains(e.target) || !e.isTrusted || e.button !== 0 || !e.isPrimary) return;
    this.button.setPointerCapture(e.pointerId);
    this.press({ pointer: e.pointerId, touch: e.pointerType !== "mouse", x: e.clientX, y: e.clientY });
  }

  pointerMoved(e) {
    if (!this.down || e.pointerId !== this.by.pointer) return;
    [this.by.x, this.by.y] = [e.clientX, e.clientY];
    if (!(e.buttons & 1)) this.release("the button was released");
    else if (!this.isOver()) this.release("the pointer left the button");
  }

  // whether the pointer is on the button, which may have moved away below it
  isOver() {
    if (this.by.pointer === undefined) return true;
    const box = this.button.getBoundingClientRect();
    return this.by.x >= box.left && this.by.x <= box.right && this.by.y >= box.top && this.by.y <= box.bottom;
  }

  keyDown(e) {
    const presses = e.key === "Enter" && e.target === this.button && !MODIFIERS.some((name) => e[name]);
    if (presses) e.preventDefault();
    if (this.down) {
      const repeats = presses && e.repeat && e.code === this.by.key;
      if (!repeats && !HOLDS.includes(e.key)) this.release("another key was pressed");
    } else if (presses && !e.repeat && e.isTrusted) {
      this.press({ key: e.code });
    }
  }

  press(by) {
    const plan = this.plan();
    if (!plan || this.button.disabled) return;
    this.button.focus();
    [this.down, this.by] = [plan, by];
    this.button.classList.add("down");
    this.link.say("press", { arm: plan.arm, plan_id: plan.id });
  }

  challenge(asked) {
    if (!this.down) return this.link.say("release", { why: "the button is up" });
    const why = this.away() || this.blind(asked);
    if (why) return this.release(why);
    this.link.say("beat", { challenge: asked.challenge });
  }

  // why nobody may be there, as far as it was not told
  away() {
    if (document.hidden || !document.hasFocus()) return "the page is not looked at";
    if (document.activeElement !== this.button) return "the button lost the focus";
    if (this.button.disabled) return "the button cannot be pressed any more";
    return this.isOver() ? "" : "the button moved away";
  }

  release(why) {
    if (!this.down) return;
    [this.down, this.by] = [null, null];
    this.button.classList.remove("down");
    this.link.say("release", { why });
  }
}
