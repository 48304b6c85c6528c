# SPDX-License-Identifier: Apache-2.0
"""Style sheet of HTML reports: light and dark screens, and paper; no fonts from elsewhere."""

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #59636e; --line: #d0d7de;
  --paper: #ffffff; --tile: #f4f6f8; --before: #d55e00; --after: #0072b2; --noise: #808080; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --soft: #9aa4af; --line: #3a424b;
  --paper: #15181c; --tile: #1f242a; --after: #4aa3df; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 1.5rem; background: var(--paper);
  color: var(--ink); font: 16px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.05rem; font-weight: 600; margin: 0; color: var(--soft); }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-top: 1px solid var(--line);
  padding-top: 1rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 0.2rem; }
p { margin: 0.4rem 0; max-width: 52rem; }
.verdict { font-size: 1.5rem; line-height: 1.3; margin: 0.4rem 0 1rem; font-weight: 600; }
.badge { display: inline-block; padding: 0.1rem 0.6rem; border-radius: 1rem; font-size: 0.85rem;
  font-weight: 600; border: 1px solid currentColor; margin-left: 0.5rem; }
.soft { color: var(--soft); font-size: 0.9rem; }
.bars { display: grid; grid-template-columns: max-content 1fr max-content; gap: 0.35rem 0.8rem;
  align-items: center; max-width: 46rem; }
.track { position: relative; height: 1.3rem; background: var(--tile); }
.fill { position: absolute; inset: 0 auto 0 0; }
.range { position: absolute; top: 0.55rem; height: 0.2rem; background: var(--ink); }
table { border-collapse: collapse; width: 100%; margin: 0.5rem 0; }
th, td { text-align: left; vertical-align: top; padding: 0.35rem 0.8rem 0.35rem 0;
  border-bottom: 1px solid var(--line); overflow-wrap: anywhere; }
th { font-weight: 600; color: var(--soft); font-size: 0.85rem; }
td.number, th.number { text-align: right; white-space: nowrap; }
th { white-space: nowrap; } td.short { min-width: 4rem; } td.words { min-width: 8.5rem; }
table.halves { table-layout: fixed; }
table table { width: auto; margin: 0; }
table table td { border: 0; padding: 0 0.8rem 0 0; white-space: nowrap; }
svg { width: 100%; height: auto; color: var(--ink); }
svg text { fill: currentColor; }
figure { margin: 1rem 0; break-inside: avoid; }
figcaption { font-size: 0.9rem; color: var(--soft); }
li { margin: 0.25rem 0; max-width: 52rem; }
@media print { body { max-width: none; padding: 0; font-size: 11pt; }
  h2, h3 { break-after: avoid; } tr { break-inside: avoid; } figure svg { max-height: 11cm; } }
"""
