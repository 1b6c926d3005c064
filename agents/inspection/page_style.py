"""How a page looks: colours for light and dark, named by what they are for."""

from agents.inspection.charts import COLOURS

_BASE = """
:root { color-scheme: light dark; --ink: #1c1f23; --paper: #ffffff; --dim: #667079; --line: #d9dee3; --mark: #b0b8c0;
  --k0: #1f6fb4; --k1: #c2571a; --k2: #2b8a3e; --k3: #9c36b5; --k4: #b0860b; --k5: #d6336c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7ea; --paper: #16191c; --dim: #98a2ab; --line: #31373d;
  --mark: #59636c; --k0: #6cb2f0; --k1: #f29a63; --k2: #69db7c; --k3: #d49bea; --k4: #e8c24a; --k5: #f783ac; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2rem auto;
  max-width: 76rem; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.05rem; margin-top: 2.2rem; } p { margin: .2rem 0; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .87rem; }
th { text-align: left; font-weight: 600; color: var(--dim); } th, td { padding: .15rem .9rem .15rem 0;
  border-bottom: 1px solid var(--line); vertical-align: top; } .figure { text-align: right;
  font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figcaption { font-size: .87rem; color: var(--dim); } svg { width: 100%; height: auto; }
polyline { fill: none; stroke-width: 1.4; } .grid { stroke: var(--line); } .mark { stroke: var(--mark);
  stroke-dasharray: 3 3; }
.tick { fill: var(--dim); font-size: 11px; } .right { text-anchor: end; } .middle { text-anchor: middle; }
.key { margin-left: .9rem; font-weight: 600; } .pictures { display: flex; flex-wrap: wrap; gap: .6rem; }
.pictures figure { margin: 0; width: 15.5rem; } .pictures img { width: 100%; border-radius: 3px; }
"""
_LINES = (
    "polyline.c{i} {{ stroke: var(--k{i}); }} circle.c{i} {{ fill: var(--k{i}); }} .key.c{i} {{ color: var(--k{i}); }}"
)
STYLE = _BASE + "\n".join(_LINES.format(i=i) for i in range(COLOURS))
