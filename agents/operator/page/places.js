// Places of what is drawn, and what is written beside them.

// of a jaw told as tip, pin and tip, in pixels or in space, between the tips
export function middle(points) {
  return points.length === 3 ? points[0].map((v, k) => (v + points[2][k]) / 2) : points[0];
}

export function crossingWords({ s, over }) {
  const [first, second] = s.map((each) => each.toFixed(2));
  if (over === "undetermined") return `crossing of ${first} and ${second}`;
  return over === "first" ? `crossing: ${first} over ${second}` : `crossing: ${second} over ${first}`;
}
