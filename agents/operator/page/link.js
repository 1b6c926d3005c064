// The one connection to the server: a link's token becomes a secret, each secret is used once and gives the next.

const KEY = "suturegrasp-secret";
const AGAIN_MS = 1000;
const SURE_MS = 1000; // a server that is heard so long after a hold has had it

async function firstSecret() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    history.replaceState(null, "", location.pathname);
    const answer = await fetch("/session", { method: "POST", body: JSON.stringify({ token }) });
    if (answer.ok) sessionStorage.setItem(KEY, (await answer.json()).secret);
  }
  return sessionStorage.getItem(KEY);
}

export async function connect(on) {
  const secret = await firstSecret();
  if (!secret) return on.shut("Open the newest link that suturegrasp page printed; each works once.");
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  let socket = null;
  let heldMs = null; // of a hold that may not have arrived; it is said again once the link is back
  const link = {
    say(kind, rest = {}) {
      if (kind === "hold") heldMs = performance.now();
      if (socket?.readyState === 1) socket.send(JSON.stringify({ kind, ...rest }));
    },
  };
  const open = () => {
    let entered = false;
    socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => link.say("hello", { secret: sessionStorage.getItem(KEY) });
    socket.onmessage = (event) => {
      if (entered && performance.now() - heldMs > SURE_MS) heldMs = null;
      if (typeof event.data !== "string") return on.picture(...unpacked(event.data));
      const message = JSON.parse(event.data);
      if (message.kind === "welcome") {
        sessionStorage.setItem(KEY, message.secret);
        entered = true;
        if (heldMs !== null) link.say("hold");
      }
      on[message.kind]?.(message);
    };
    socket.onclose = (event) => {
      if (event.code === 1008) {
        sessionStorage.removeItem(KEY);
        return on.shut("This page's link was used elsewhere. Open the newest link that suturegrasp page printed.");
      }
      on.lost();
      setTimeout(open, AGAIN_MS);
    };
  };
  open();
  return link;
}

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return [header, new Blob([new Uint8Array(buffer, 4 + length)], { type: "image/jpeg" })];
}
