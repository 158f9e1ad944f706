"""How the page looks: one column on a phone, the contents beside it where there is room."""

STYLE = """
:root {
  --text: #1d1f23; --muted: #5a5f68; --line: #d9dce1; --soft: #f4f5f7; --link: #0060a0; --warn: #a33f00;
}
* { box-sizing: border-box; }
html { color-scheme: light; scroll-behavior: smooth; -webkit-text-size-adjust: 100%; }
body {
  margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 50rem; background: #fff; color: var(--text);
  font: 1rem/1.6 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif;
  overflow-wrap: break-word;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .75rem; letter-spacing: -.01em; }
h2 { font-size: 1.4rem; line-height: 1.25; margin: 0 0 .25rem; letter-spacing: -.005em; }
p { margin: 0 0 1rem; }
a { color: var(--link); text-underline-offset: .15em; }
a:focus-visible, summary:focus-visible, .scroll:focus-visible { outline: 2px solid var(--link); outline-offset: 2px; }
.about, figcaption, nav small { color: var(--muted); font-size: .875rem; line-height: 1.5; }
nav { margin: 1.5rem 0 0; padding: 1rem 1.25rem; background: var(--soft); border-radius: .5rem; }
nav h2 { font-size: .875rem; color: var(--muted); font-weight: 600; letter-spacing: 0; }
nav ol { margin: 0; padding: 0; list-style: none; }
nav li { margin: 0; }
nav a { display: inline-block; padding: .25rem 0; text-decoration: none; }
nav a:hover { text-decoration: underline; }
section { margin-top: 3rem; padding-top: 2rem; border-top: 1px solid var(--line); scroll-margin-top: 0; }
.note { padding: .6rem .9rem; border-left: 4px solid var(--warn); background: #fdf4ee; white-space: pre-line; }
figure { margin: 1.75rem 0; }
img { display: block; max-width: 100%; height: auto; }
figcaption { margin-top: .6rem; color: var(--text); }
.files { white-space: nowrap; margin-left: .25rem; font-size: .8125rem; }
.scroll { overflow-x: auto; }
/* A shadow at the side where a table goes on: it scrolls, and the white that hides it moves with the table. */
.table .scroll, details .scroll {
  background:
    linear-gradient(to right, #fff 30%, #fff0) left / 2rem 100% no-repeat local,
    linear-gradient(to left, #fff 30%, #fff0) right / 2rem 100% no-repeat local,
    linear-gradient(to right, #0002, #0000) left / .75rem 100% no-repeat scroll,
    linear-gradient(to left, #0002, #0000) right / .75rem 100% no-repeat scroll;
}
.table { margin: 1.75rem 0; }
.table .about, details .about { margin: 0 0 .5rem; }
.table .scroll + .about { margin: .5rem 0 0; }
details .scroll + .about { margin-top: 1rem; }
table { border-collapse: collapse; font-size: .875rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .75rem; text-align: left; vertical-align: top; white-space: nowrap; }
th:first-child, td:first-child { padding-left: 0; }
thead th { border-bottom: 1px solid var(--text); font-weight: 600; vertical-align: bottom; }
thead small { display: block; color: var(--muted); font-weight: 400; font-size: .8125rem; }
tbody tr { border-bottom: 1px solid var(--line); }
tbody th { font-weight: 400; }
.number { text-align: right; }
.compared { width: 100%; }
.compared tbody tr { border-bottom: 0; color: var(--muted); }
.compared tbody tr:nth-child(3n) { border-bottom: 1px solid var(--line); }
.compared tbody tr:nth-child(3n + 1), .compared th[scope="rowgroup"] { color: var(--text); }
.compared tbody tr:nth-child(3n + 1) td { font-weight: 600; }
.compared th[scope="row"] { padding-left: 0; }
.facts th { color: var(--muted); }
.facts td, .facts a {
  font-family: ui-monospace, "SF Mono", Menlo, Consolas, "DejaVu Sans Mono", monospace; font-size: .8125rem;
}
details { border-top: 1px solid var(--line); padding: .25rem 0; }
details:last-child { border-bottom: 1px solid var(--line); }
details[open] { padding-bottom: 1rem; }
summary { cursor: pointer; padding: .4rem 0; color: var(--link); }
@media (max-width: 36rem) {
  h1 { font-size: 1.6rem; }
  h2 { font-size: 1.25rem; }
  th, td { padding-left: .4rem; padding-right: .4rem; }
  table { font-size: .8125rem; }
}
@media (min-width: 70rem) {
  body {
    max-width: 70rem; padding-top: 3rem;
    display: grid; grid-template-columns: 14rem minmax(0, 1fr); column-gap: 4rem;
  }
  header { grid-column: 2; }
  nav {
    grid-column: 1; grid-row: 1 / span 2; position: sticky; top: 3rem; align-self: start; margin: 0; padding: 0;
    background: none; max-height: calc(100vh - 6rem); overflow-y: auto; font-size: .9375rem;
  }
  main { grid-column: 2; }
}
@media print {
  nav { display: none; }
  section { break-before: page; border-top: 0; }
  figure, .table { break-inside: avoid; }
  .scroll { overflow: visible; }
}
"""
