// What the server packs: lists of numbers as single floats in base 64.

export function numbers(text) {
  const bytes = Uint8Array.from(atob(text), (each) => each.charCodeAt(0));
  return Array.from(new Float32Array(bytes.buffer));
}

export function tuples(text, size) {
  const flat = numbers(text);
  return Array.from({ length: flat.length / size }, (_, i) => flat.slice(size * i, size * (i + 1)));
}

export function threadOf(told) {
  if (!told) return null;
  return { ...told, px: tuples(told.px, 2), mm: tuples(told.mm, 3), confidence: numbers(told.confidence), unseen: numbers(told.unseen) };
}
