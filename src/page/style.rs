//! The pages' look.

/// One stylesheet for all pages; colours follow the reader's setting.
pub const STYLE: &str = "\
:root{color-scheme:light dark;--line:#8885;--soft:#8881;--accent:#2a6fb0;--warn:#c77700;\
--c0:#2a6fb0;--c1:#c4572b;--c2:#2e8b57;--c3:#8a5fbf;--c4:#b08900;--c5:#c2437e;--c6:#5b7083;\
font:16px/1.5 system-ui,sans-serif}\
@media(prefers-color-scheme:dark){:root{--accent:#6fb1ee;--warn:#f0a63c;\
--c0:#6fb1ee;--c1:#f08a5d;--c2:#62c08a;--c3:#b994ea;--c4:#dcb93c;--c5:#ee7fb0;--c6:#9db2c4}}\
body{margin:0 auto;max-width:76rem;padding:1rem 1.25rem 4rem}\
h1{font-size:1.7rem;margin:.5rem 0 1rem}\
h2{font-size:1.2rem;margin:2.2rem 0 .6rem;border-top:1px solid var(--line);padding-top:.8rem}\
p,li,.note{max-width:60rem}\
small{display:block;opacity:.75}\
figure{margin:0}figcaption{font-size:.85rem;opacity:.8;margin:.2rem 0 .6rem}\
img,svg{max-width:100%;height:auto;border-radius:.25rem}\
.row{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,30rem),1fr));gap:.6rem 1.2rem}\
dl{display:grid;grid-template-columns:repeat(auto-fill,minmax(9.5rem,1fr));gap:.6rem;margin:0}\
dl div{background:var(--soft);border-radius:.4rem;padding:.45rem .7rem}\
dt{font-size:.8rem;opacity:.75}dd{margin:0;font-size:1.15rem;font-variant-numeric:tabular-nums}\
.note{border-left:.3rem solid var(--warn);background:var(--soft);padding:.4rem .8rem;margin:.5rem 0}\
.wide{overflow-x:auto}\
table{border-collapse:collapse;font-size:.92rem}\
th,td{border-bottom:1px solid var(--line);padding:.2rem .9rem .2rem 0;text-align:left;vertical-align:top}\
td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}\
summary{cursor:pointer;margin:.6rem 0}\
svg{background:var(--soft)}svg text{fill:currentColor;font:11px system-ui,sans-serif}\
svg .grid{stroke:var(--line);stroke-width:1}svg path{fill:none;stroke-width:1.6}";
