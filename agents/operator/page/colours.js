// Colours that colour-blind people tell apart (viridis, by lightness too), and a second sign for each: width and dashes.

const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
export const UNSEEN = "#c9c9cf";
export const PHASES = { approach: "#9bb8ff", capture: "#ffb454", slide: "#5cd6ff", grasp: "#ff8ae0", retreat: "#b9bdcc" };
export const TOOL = "#f2f4fa";
export const SEEN_TOOL = "#ffe9a8";
export const GOAL = "#ffffff";

export const CLASSES = [
  { name: "sure", words: "confidence 90 % and more", width: 4.5, dash: [], sample: 1.0 },
  { name: "fair", words: "60 to 90 %", width: 3.2, dash: [14, 4], sample: 0.72 },
  { name: "unsure", words: "below 60 %", width: 3, dash: [7, 6], sample: 0.3 },
  { name: "unseen", words: "not seen by both eyes", width: 2.5, dash: [2, 6], sample: null },
];

export function classOf(confidence, unseen) {
  if (unseen || confidence < 0) return CLASSES[3];
  return confidence >= 0.9 ? CLASSES[0] : confidence >= 0.6 ? CLASSES[1] : CLASSES[2];
}

export function confidenceColour(confidence) {
  if (confidence === null || confidence < 0) return UNSEEN;
  // the darkest fifth of the map is lost on tissue
  const at = (0.18 + 0.82 * Math.min(1, confidence)) * (VIRIDIS.length - 1);
  const i = Math.min(VIRIDIS.length - 2, Math.floor(at));
  const mix = VIRIDIS[i].map((v, k) => Math.round(v + (at - i) * (VIRIDIS[i + 1][k] - v)));
  return `rgb(${mix})`;
}

// runs of neighbouring places of one class, each to be drawn at once
export function runsOf(thread) {
  const runs = [];
  for (let i = 0; i + 1 < thread.px.length; i++) {
    const kind = classOf(Math.min(thread.confidence[i], thread.confidence[i + 1]), thread.unseen[i] && thread.unseen[i + 1]);
    const last = runs.at(-1);
    if (last && last.kind === kind) last.end = i + 1;
    else runs.push({ kind, begin: i, end: i + 1 });
  }
  return runs;
}

export function legend(list) {
  list.innerHTML = "";
  const entries = [
    ...CLASSES.map((k) => [k.sample === null ? UNSEEN : confidenceColour(k.sample), k.dash, k.width, `${k.name}: ${k.words}`]),
    [PHASES.slide, [], 2, "plan"], [TOOL, [], 4, "tool"],
  ];
  for (const [colour, dash, width, words] of entries) {
    const item = document.createElement("li");
    const line = (stroke, wide) => `<line x1="3" x2="39" y1="7" y2="7" stroke="${stroke}" stroke-width="${wide}" stroke-dasharray="${dash}"/>`;
    const edge = words.startsWith("unsure") ? line("#fff", width + 2.5) : "";
    item.innerHTML = `<svg width="42" height="14" aria-hidden="true">${edge}${line(colour, width)}</svg>`;
    item.append(words);
    list.append(item);
  }
  // what is no line: circles, each with its look in the picture
  for (const [look, words] of [
    ['<circle cx="21" cy="7" r="5.5" fill="none" stroke="#fff" stroke-width="1.6"/>', "crossing"],
    [`<circle cx="21" cy="7" r="5" fill="none" stroke="${GOAL}" stroke-width="1.5"/><path d="M12 7h18M21 0v14" stroke="${GOAL}"/>`, "goal"],
    [`<circle cx="13" cy="7" r="4.5" fill="${confidenceColour(0.9)}" stroke="#fff"/><circle cx="30" cy="7" r="4.5" fill="#0008" stroke="#fff"/>`, "other captures: possible, not possible"],
    [`<path d="M6 9l5-4l5 4l5-4l5 4l5-4l5 4" fill="none" stroke="${SEEN_TOOL}" stroke-width="2" stroke-dasharray="2 2"/>`, "tool as the images show it"],
    ['<g fill="#fff" stroke="#000"><circle cx="11" cy="7" r="2.2"/><circle cx="21" cy="7" r="2.2"/><circle cx="31" cy="7" r="2.2"/></g>', "observations"],
  ]) {
    const item = document.createElement("li");
    item.innerHTML = `<svg width="42" height="14" aria-hidden="true">${look}</svg>`;
    item.append(words);
    list.append(item);
  }
}
