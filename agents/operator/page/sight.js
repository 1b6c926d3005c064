// How old the picture is that is really drawn, by the clock of an arm's bridge alone.
//
// The camera echoes in each frame the newest challenge of the bridge that it had heard. So between a challenge and the
// one that the drawn picture echoes lies at least the picture's age, however far clocks are apart and however long a
// queue is. Challenges are nanoseconds since 1970: as text on their way, and as BigInt here, for a number would round.

// an upper bound in ms, at the time of the bridge's challenge `at_ns`; null where it cannot be told
export function ageMs(drawn, arm, at_ns) {
  const [echo, at] = [BigInt(drawn?.echoes?.[arm] ?? "0"), BigInt(at_ns)];
  return echo && at ? Number(at - echo) / 1e6 : null;
}

// why an arm must not be moved by what is drawn, or ""; what cannot be told speaks against a real arm alone
export function whyBlind(drawn, { arm, at_ns, limit_ms, real }) {
  const age = ageMs(drawn, arm, at_ns);
  if (age === null || !limit_ms) return real ? `nobody knows how old the picture is, for it echoes no challenge of ${arm}` : "";
  if (age > limit_ms) return `the picture is ${seconds(age)} old, and ${seconds(limit_ms)} are allowed`;
  // a frame may echo a challenge that this page has not heard of yet, but none that lies so far ahead
  return age < -limit_ms ? `the picture was taken before the clock of the bridge of ${arm} was set` : "";
}

export function seconds(ms) { return `${(ms / 1000).toFixed(2)} s`; }
