// The button that arms: pressed and held, by pointer or by Enter. Each challenge of the server is answered by hand of
// this very code, and only while the page is seen and has the focus; whatever else happens lets go.

export class DeadMan {
  constructor(button, link, plan) {
    this.button = button;
    this.link = link;
    this.plan = plan;
    this.down = null;
    const let_go = (why) => () => this.release(why);
    button.addEventListener("pointerdown", (e) => {
      if (e.button !== 0 || !e.isPrimary) return;
      button.setPointerCapture(e.pointerId);
      this.press("pointer");
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(kind, let_go("the button was released"));
    button.addEventListener("contextmenu", (e) => e.preventDefault());
    button.addEventListener("keydown", (e) => {
      if (e.key !== "Enter") return;
      e.preventDefault();
      if (!e.repeat) this.press("key");
    });
    button.addEventListener("keyup", (e) => { if (e.key === "Enter") this.release("the key was released"); });
    button.addEventListener("blur", let_go("the button lost the focus"));
    addEventListener("blur", let_go("the page lost the focus"));
    addEventListener("pagehide", let_go("the page was left"));
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.release("the page was hidden"); });
    document.addEventListener("freeze", let_go("the page was frozen"));
  }

  press() {
    const plan = this.plan();
    if (!plan || this.button.disabled) return;
    this.button.focus();
    this.down = plan;
    this.button.classList.add("down");
    this.link.say("press", { arm: plan.arm, plan_id: plan.id });
  }

  challenge(challenge) {
    if (!this.down) return this.link.say("release", { why: "the button is up" });
    if (document.hidden || !document.hasFocus()) return this.release("the page is not looked at");
    this.link.say("beat", { challenge });
  }

  release(why) {
    if (!this.down) return;
    this.down = null;
    this.button.classList.remove("down");
    this.link.say("release", { why });
  }
}
