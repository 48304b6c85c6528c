# SPDX-License-Identifier: Apache-2.0
"""Style sheet of HTML reports, and their plain text as metrologists write it.

Light and dark screens, and paper; no fonts from elsewhere. Colours are those of Okabe and Ito
(2008), distinguishable for colour-blind readers too.
"""

from __future__ import annotations

import html
import re

from otf_core.files.message_text import with_micro_sign

MARKS = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #59636e; --line: #d0d7de;
  --paper: #ffffff; --tile: #f4f6f8; --before: #d55e00; --after: #0072b2; --noise: #808080;
  --x: #0072b2; --y: #d55e00; --z: #009e73; --good: #1a7f37; --bad: #c0260c; --open: #9a6700; }
@media screen and (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --soft: #9aa4af;
  --line: #3a424b; --paper: #15181c; --tile: #1f242a; --before: #f08a3c; --after: #4aa3df;
  --x: #4aa3df; --y: #f08a3c; --z: #2fc79b; --good: #4ac26b; --bad: #ff7b72; --open: #d9a520; } }
svg text { fill: var(--ink); font: 11px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
svg text.soft { fill: var(--soft); font-size: 11px; } svg text.end { text-anchor: end; }
svg text.middle { text-anchor: middle; } svg text.strong { font-weight: 600; font-size: 12px; }
svg text.over { paint-order: stroke; stroke: var(--paper); stroke-width: 3px;
  stroke-linejoin: round; } .dots.disc { opacity: 0.55; }
.line { fill: none; stroke-width: 1.6; stroke-linejoin: round; } .area { stroke: none; }
.dots { fill: none; stroke-width: 3; stroke-linecap: round; }
.grid { fill: none; stroke: var(--line); stroke-width: 0.8; }
.line.ink, .dots.ink { stroke: var(--ink); } .area.ink { fill: var(--ink); }
.line.dark { stroke: #1b1f24; }
.line.soft, .dots.soft { stroke: var(--soft); stroke-width: 1; } .area.soft { fill: var(--soft); }
.line.before, .dots.before { stroke: var(--before); } .area.before { fill: var(--before); }
.line.after, .dots.after { stroke: var(--after); } .area.after { fill: var(--after); }
.line.noise, .dots.noise { stroke: var(--noise); } .area.noise { fill: var(--noise); }
.line.x, .dots.x { stroke: var(--x); } .area.x { fill: var(--x); }
.line.y, .dots.y { stroke: var(--y); } .area.y { fill: var(--y); }
.line.z, .dots.z { stroke: var(--z); } .area.z { fill: var(--z); }
.area.good { fill: var(--good); } .area.bad { fill: var(--bad); }
.area.open { fill: var(--open); } .area.band { opacity: 0.28; } .line.thin { stroke-width: 1; }
.line.good { stroke: var(--good); } .line.bad { stroke: var(--bad); }
.line.dash { stroke-dasharray: 5 3; }
.dots.small { stroke-width: 2; } .dots.node { stroke-width: 4.5; }
.dots.big { stroke-width: 8; } .line.open { stroke: var(--open); }
.line.dot { stroke-dasharray: 1.5 3; } .line.thick { stroke-width: 2.4; }
.s0 { --s: #2c5fa8; } .s1 { --s: #d55e00; } .s2 { --s: #009e73; } .s3 { --s: #cc79a7; }
.s4 { --s: #b97f00; } .s5 { --s: #2f94d1; } .s6 { --s: #8a6d3b; } .s7 { --s: #7a7f87; }
.s8 { --s: #a05195; } .s9 { --s: #8a9130; } .area.share { fill: var(--s); }
.h0 { --s: #fbe3c4; } .h1 { --s: #f9c78a; } .h2 { --s: #f4a14f; } .h3 { --s: #e5702c; }
.h4 { --s: #c9421a; } .h5 { --s: #941f10; } .line.heat { stroke: var(--s); } .area.heat {
  fill: var(--s); } .dots.heat { stroke: var(--s); } .line.arrow { stroke-width: 1.8; }
@media screen and (prefers-color-scheme: dark) { .s0 { --s: #5f8fdc; } .s3 { --s: #dd9abc; }
  .s6 { --s: #b08e52; } .s8 { --s: #c07ab0; } .h4 { --s: #de5830; } .h5 { --s: #d8364a; } }
.turn { overflow: visible; touch-action: pan-y; cursor: grab; } .turn:active { cursor: grabbing; }
"""
"""Colours, and the marks of pictures."""
STYLE = (
    MARKS
    + """
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 78rem; padding: 1.2rem 1.5rem; background: var(--paper);
  color: var(--ink); font: 16px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.05rem; font-weight: 600; margin: 0; color: var(--soft); }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; border-top: 1px solid var(--line);
  padding-top: 1rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 0.2rem; }
p { margin: 0.4rem 0; overflow-wrap: anywhere; }
@media screen and (min-width: 900px) { .words.many { columns: 2; column-gap: 2.5rem; }
  .words.many p { break-inside: avoid; } .words.many p:first-child { margin-top: 0; } }
nav { font-size: 0.9rem; margin: 1rem 0; } nav a { color: var(--soft); margin-right: 0.9rem;
  white-space: nowrap; display: inline-block; }
.verdict { font-size: 1.5rem; line-height: 1.3; margin: 0.4rem 0 1rem; font-weight: 600; }
.badge { display: inline-block; padding: 0.1rem 0.6rem; border-radius: 1rem; font-size: 0.85rem;
  font-weight: 600; border: 1px solid currentColor; margin: 0 0.5rem 0.2rem 0; }
.badges { margin-left: 0.5rem; }
.good { color: var(--good); } .bad { color: var(--bad); } .open { color: var(--open); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: 0.8rem;
  margin: 1rem 0; }
.tile { background: var(--tile); padding: 0.7rem 0.9rem; border-radius: 0.4rem;
  break-inside: avoid; }
.tile b { display: block; font-size: 1.5rem; line-height: 1.25; }
.tile span { display: block; color: var(--soft); font-size: 0.9rem; }
.soft { color: var(--soft); font-size: 0.9rem; }
.track { position: relative; height: 1.3rem; background: var(--tile); }
.bars { display: grid; grid-template-columns: max-content 1fr max-content; gap: 0.35rem 0.8rem;
  align-items: center; max-width: 46rem; }
.fill { position: absolute; inset: 0 auto 0 0; }
.range { position: absolute; top: 0.55rem; height: 0.2rem; background: var(--ink); }
.scroll { overflow-x: auto; background:
  linear-gradient(90deg, var(--paper) 40%, transparent) 0 0 / 2.5rem 100% no-repeat local,
  linear-gradient(270deg, var(--paper) 40%, transparent) 100% 0 / 2.5rem 100% no-repeat local,
  linear-gradient(90deg, var(--line), transparent) 0 0 / 0.9rem 100% no-repeat scroll,
  linear-gradient(270deg, var(--line), transparent) 100% 0 / 0.9rem 100% no-repeat scroll; }
table { border-collapse: collapse; width: 100%; margin: 0.5rem 0; }
caption { text-align: left; font-weight: 600; padding: 0.4rem 0 0.1rem; }
th, td { text-align: left; vertical-align: top; padding: 0.35rem 0.8rem 0.35rem 0;
  border-bottom: 1px solid var(--line); overflow-wrap: break-word; }
th { font-weight: 600; color: var(--soft); font-size: 0.85rem; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
td > b { font-weight: 600; } td > b[class] { white-space: nowrap; }
.sheet { columns: 28rem 2; column-gap: 2.5rem; } .sheet > * { break-inside: avoid; }
.pictures { display: grid; gap: 0.6rem 1rem; }
@media screen and (min-width: 620px) { .pictures.two, .pictures.three {
  grid-template-columns: 1fr 1fr; } }
@media print, screen and (min-width: 900px) { .pictures.three {
  grid-template-columns: 1fr 1fr 1fr; } .pictures.two { grid-template-columns: 1fr 1fr; } }
#overview svg.turn { max-height: 21rem; } #overview figure { margin: 0.5rem 0; }
svg { width: 100%; height: auto; color: var(--ink); display: block; }
.keys > span { white-space: nowrap; margin-right: 0.8em; display: inline-block; }
.key { display: inline-block; width: 0.8em; height: 0.8em; background: var(--s);
  margin-right: 0.35em; } .good-key { --s: var(--good); } .bad-key { --s: var(--bad); }
.open-key { --s: var(--open); } .after-key { --s: var(--after); }
.before-key { --s: var(--before); }
.key.stroke { width: 2px; height: 1.1em; background: var(--ink); vertical-align: middle; }
figure { margin: 1rem 0; break-inside: avoid; }
figcaption { font-size: 0.9rem; color: var(--soft); margin-top: 0.2rem; }
details summary { cursor: pointer; color: var(--soft); }
li { margin: 0.25rem 0; overflow-wrap: anywhere; }
@media (max-width: 520px) { body { padding: 1rem 0.8rem; } .verdict { font-size: 1.2rem; }
  th, td { padding-right: 0.5rem; font-size: 0.9rem; }
  td.number { white-space: normal; } .facts td { overflow-wrap: anywhere; }
  .cards thead { display: none; } .cards tr { display: block; padding: 0.4rem 0;
  border-bottom: 1px solid var(--line); } .cards td { display: block; border: none;
  padding: 0.1rem 0; text-align: left; } .cards td:empty { display: none; }
  .cards td[data-head]::before { font-size: 0.8rem;
  content: attr(data-head) ": "; color: var(--soft); } }
.signatures { display: grid; grid-template-columns: 1fr 1fr 1fr; gap: 2rem; margin-top: 3.2rem; }
.signatures div { border-top: 1px solid var(--ink); padding-top: 0.2rem; font-size: 0.85rem; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } nav, .screen,
  .screen-only { display: none; } h2 { margin-top: 1rem; padding-top: 0.5rem; }
  h2, h3, caption { break-after: avoid; } tr, li { break-inside: avoid; }
  .verdict { font-size: 14pt; } .tile b { font-size: 14pt; } .tiles { margin: 0.5rem 0; }
  th, td { padding-top: 0.2rem; padding-bottom: 0.2rem; }
  .scroll { overflow: visible; background: none; } thead { display: table-header-group;
  break-after: avoid; } details:not([open]) { display: none; } p { orphans: 3; widows: 3; }
  tbody tr:first-child, tbody tr:nth-child(2), tbody tr:nth-child(3) { break-before: avoid; }
  tbody tr:nth-last-child(-n+2) { break-before: avoid; } .facts { break-inside: avoid; }
  #certificate-errors { break-before: page; } #certificate-errors td { padding: 0.08rem 0.8rem
  0.08rem 0; font-size: 9pt; }
  #certificate-volume svg { max-height: 52mm; } #subject table { margin: 0.2rem 0; }
  #subject td:first-child { width: 42%; } #statement p { font-size: 9pt; }
  #subject td { padding: 0.1rem 0.8rem 0.1rem 0; font-size: 9pt; }
  .sheet { columns: 2; } figure { margin: 0.5rem 0; }
  .tile { padding: 0.4rem 0.6rem; } .tile span, figcaption, .keys { font-size: 8.5pt; }
  figure svg { max-height: 13cm; } .long { break-inside: auto; }
  .pictures > div { break-inside: avoid; } #overview svg.turn { max-height: 5cm; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""
)
"""The whole page."""
SPACE = '\u00a0'
"""Does not break a line."""
UNITS = '%|[µmk]?m|µrad|mrad|rad|µs|ms|s|min|h|d|°C|K|Hz|Pa|m/s|m/s²'


def running_head(words: str) -> str:
    """Rules that print words at the head, and the number of the page at the foot, of each page.

    Parameters
    ----------
    words : str
        Machine, run, date.
    """
    quoted = ''.join(c if c.isalnum() or c in ' .,:;-+/()' else f'\\{ord(c):x} ' for c in words)
    box = 'font: 8pt system-ui, "DejaVu Sans", sans-serif; color: #59636e;'
    return (
        '@page { size: A4; margin: 16mm 14mm 14mm; '
        f'@top-left {{ content: "{quoted}"; {box} }} '
        f'@bottom-right {{ content: counter(page) " / " counter(pages); {box} }} }}\n'
    )


def typeset(value: object) -> str:
    """Text with proper signs, not escaped; a value stays on the line of its sign and unit."""
    plain = with_micro_sign(str(value))
    plain = re.sub(r'(?<![^ (])\+/-(?= )', '±', plain)
    plain = re.sub(r'(?<![\w.])-(?=0(?:\.0+)?(?![\w.]))', '', plain)
    plain = re.sub(r'(?<![\w.])-(?=\d|[XYZ]\b)', '\N{MINUS SIGN}', plain)
    plain = re.sub(r'(?<=\d) deg\b', '\N{DEGREE SIGN}', plain)
    plain = re.sub(r'(?<=\S) (?=(?:±|→) )|(?<=[±→]) (?=\S)', SPACE, plain)
    return re.sub(rf'(?<=\d) (?=(?:{UNITS})(?![A-Za-z]))', SPACE, plain)


def text(value: object) -> str:
    """The same, escaped for HTML."""
    return html.escape(typeset(value), quote=True)
