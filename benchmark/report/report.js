// SPDX-License-Identifier: Apache-2.0
// The page's behaviour: choose shift, geometry and frame; open pictures large; slider; error maps; tables.
"use strict";
const D = JSON.parse(document.getElementById("data").textContent);
const state = { frame: D.frames[0], shift: D.shifts[0].name, method: D.methods[0], compare: D.cameras[0], error: D.cameras[0], at: 50,
  arm: (D.arms.find(a => a.name.startsWith("seam-")) || D.arms[0] || {}).name, fillCamera: D.cameras[0] };
const $ = id => document.getElementById(id);
const label = () => D.shifts.find(s => s.name === state.shift).label;
const percent = v => (100 * v).toFixed(1) + " %";

function make(tag, attributes, ...children) {
  const e = document.createElement(tag);
  for (const [k, v] of Object.entries(attributes || {})) k === "class" ? e.className = v : e.setAttribute(k, v);
  e.append(...children);
  return e;
}
const recordedOf = camera => D.views[state.frame][camera].recorded;
const viewOf = camera => D.views[state.frame][camera + "|" + state.shift];

// A picture is { title, note, alt, base, dim, over, paint } of picture numbers; null pictures say why.
function stack(p) {
  const s = make("span", { class: "stack" });
  s.append(make("img", { src: D.images[p.base], alt: p.alt, class: p.dim ? "under" : "", decoding: "async" }));
  if (p.over != null) s.append(make("img", { src: D.images[p.over], alt: "", class: "over" }));
  if (p.minus != null) {
    s.append(make("img", { src: D.images[p.minus], alt: "", class: "over minus" }));
    s.classList.add("difference");
  }
  if (p.paint != null) {
    const i = make("i", { class: "over paint" });
    i.style.maskImage = i.style.webkitMaskImage = `url(${D.images[p.paint]})`;
    s.append(i);
  }
  return s;
}
function pictures(camera) {
  const v = viewOf(camera), m = v[state.method] || {}, rec = recordedOf(camera), where = `${camera}, ${label()}`;
  const why = v.why || "not in the set", has = x => x != null;
  const s = m.share, own = D.methodNames[state.method];
  return {
    recorded: { title: "Recorded", note: "where the camera was", base: rec, alt: `Recorded view of ${camera}`, ok: has(rec), why: "not in the set" },
    mask: { title: "Mask", note: s ? `${percent(s.lost)} lost, ${percent(s.unknown)} unknown` : "", base: rec, over: m.mask, dim: false, ok: has(rec) && has(m.mask), why,
      alt: `Mask of ${where}, ${own}: occluded, outside and unknown pixels tinted` + (s ? `; ${percent(s.lost)} lost` : "") },
    shifted: { title: "Shifted truth", note: v.moved ?? "the real render from there", base: v.shifted, ok: has(v.shifted), why, alt: `Real render of ${where}` },
    warp: { title: "Warp", note: has(m.hole_share) ? `${percent(m.hole_share)} holes` : "", base: m.warp, paint: m.hole, ok: has(m.warp), why, alt: `Warp of ${where}, ${own}, holes coloured` },
    holes: { title: "Holes by reason", note: m.holes_share ? `${percent(m.holes_share.disoccluded)} disoccluded, ${percent(m.holes_share.outside)} outside` : "",
      base: has(v.shifted) ? v.shifted : m.warp, over: m.holes, dim: true, ok: has(m.holes) && (has(v.shifted) || has(m.warp)), why, alt: `Holes of ${where}, ${own}, by reason` },
    error_scene: errorPicture("scene", m, rec, where, why), error_shell: errorPicture("shell", m, rec, where, why),
    difference: { title: "Warp error", note: "absolute difference to the real render", base: m.difference, ok: has(m.difference), why, alt: `Colour error of the warp of ${where}, ${own}` }
  };
}
function errorPicture(against, m, rec, where, why) {
  const c = m["counts_" + against], truth = { scene: "the true scene", shell: "what the recording could know" }[against];
  const note = c ? `right ${c.tp}, too much ${c.fp}, missed ${c.fn}, unknown and lost ${c.ul}, unknown and visible ${c.uv} px` : "";
  return { title: `Lost against the ${against}`, note, base: rec, over: m["error_" + against], dim: true, ok: rec != null && m["error_" + against] != null, why,
    alt: `Errors of the lost mask of ${where} against ${truth}: ${note}` };
}
function panel(list, i, heading) {
  const p = list[i];
  const caption = make("figcaption", {}, make("b", {}, p.title), p.note ? " · " + p.note : "");
  if (!p.ok) return make("figure", { class: "panel" }, make("div", { class: "missing" }, p.why), caption);
  const b = make("button", { class: "shot", "aria-label": "Open large: " + p.alt }, stack(p));
  b.onclick = () => open(list.filter(q => q.ok), list.filter(q => q.ok).indexOf(p), heading);
  return make("figure", { class: "panel" }, b, caption);
}
function row(camera, keys, extra) {
  const all = pictures(camera), list = keys.map(k => all[k]);
  return make("div", { class: "panels " + (extra || "") }, ...list.map((_, i) => panel(list, i, `${camera}, ${label()}`)));
}
function drawStrips() {
  $("strips").replaceChildren(...D.cameras.map(c => make("article", { class: "strip" },
    make("h3", {}, c, make("small", {}, `${label()}, ${D.methodNames[state.method]}, frame ${state.frame}`)),
    row(c, ["recorded", "mask", "shifted", "warp", "holes"]))));
}
function drawErrors() { $("error-maps").replaceChildren(row(state.error, ["error_scene", "error_shell", "difference"], "three")); }
function drawSlider() {
  const p = pictures(state.compare);
  if (!p.warp.ok || !p.shifted.ok) return $("slider").replaceChildren(make("div", { class: "missing", style: "max-width:1100px" }, p.shifted.ok ? p.warp.why : p.shifted.why));
  $("slider").replaceChildren(slider(stack(p.warp), stack(p.shifted), "warp", "real render", "Share of the picture that shows the warp"));
}
function slider(front, back, left, right, label) {
  const range = make("input", { type: "range", min: 0, max: 100, step: .5, value: state.at, "aria-label": label });
  const s = make("div", { class: "slider" }, back, front, make("span", { class: "tag l" }, left), make("span", { class: "tag r" }, right), make("div", { class: "line" }), range);
  const put = at => { state.at = at; s.style.setProperty("--at", at + "%"); };
  front.classList.add("front");
  put(state.at);
  range.oninput = () => put(+range.value);
  s.onpointermove = e => { if (e.buttons) { const r = s.getBoundingClientRect(); put(Math.min(100, Math.max(0, 100 * (e.clientX - r.left) / r.width))); range.value = state.at; } };
  return s;
}
function drawFills() {
  if (!D.arms.length) return;
  const frame = D.frames.find(f => D.cameras.some(c => D.views[f][`${c}|${state.shift}`].fills)), v = D.views[frame][`${state.fillCamera}|${state.shift}`];
  const f = (v.fills || {})[state.arm], name = D.arms.find(a => a.name === state.arm).label, where = `${state.fillCamera}, ${label()}, frame ${frame}`;
  if (!f || v.shifted == null) { $("fill-errors").replaceChildren(); return $("fill-slider").replaceChildren(make("div", { class: "missing", style: "max-width:1100px" }, v.why || "not in the set")); }
  const dB = k => f.psnr[k] == null ? "" : `${k} ${f.psnr[k].toFixed(1)} dB`, note = ["all", "lost", "hole"].map(dB).filter(Boolean).join(", ");
  const result = { title: "Result", note, base: f.picture, ok: true, alt: `Result of ${name}, ${where}` };
  const truth = { title: "Real render", note: v.moved ?? "", base: v.shifted, ok: true, alt: `Real render of ${where}` };
  const error = { title: "Difference", note: "four times as bright", base: v.shifted, minus: f.picture, ok: true, alt: `Difference of result and real render, ${where}` };
  $("fill-slider").replaceChildren(slider(stack(result), stack(truth), name, "real render", "Share of the picture that shows the result"));
  const list = [result, truth, error];
  $("fill-errors").replaceChildren(make("div", { class: "panels three" }, ...list.map((_, i) => panel(list, i, where))));
}
function draw() { drawStrips(); drawSlider(); drawErrors(); drawFills(); }

function buttons(id, options, key, after) {
  const box = $(id);
  options.forEach(([value, text]) => {
    const b = make("button", { "aria-pressed": String(state[key] === value) }, text);
    b.onclick = () => {
      state[key] = value;
      box.querySelectorAll("button").forEach(x => x.setAttribute("aria-pressed", String(x === b)));
      after();
    };
    box.append(b);
  });
  if (options.length < 2 && id !== "pick-compare" && id !== "pick-error") box.hidden = id === "pick-frame";
}
function frameMenu() {
  if (D.frames.length <= 8) return buttons("pick-frame", D.frames.map(f => [f, String(f)]), "frame", draw);
  const menu = make("select", { "aria-label": "Frame" }, ...D.frames.map(f => make("option", { value: f }, String(f))));
  menu.onchange = () => { state.frame = D.frames[menu.selectedIndex]; draw(); };
  $("pick-frame").append(menu);
}

let shown = null;
function show(step) {
  shown.at = (shown.at + step + shown.list.length) % shown.list.length;
  const p = shown.list[shown.at];
  $("large-title").textContent = `${p.title} — ${shown.heading}`;
  $("large-note").textContent = p.note;
  $("large-picture").replaceChildren(stack(p));
}
function open(list, at, heading) { shown = { list, at, heading }; show(0); $("large").showModal(); }
$("large-previous").onclick = () => show(-1);
$("large-next").onclick = () => show(1);
$("large-close").onclick = () => $("large").close();
$("large").addEventListener("click", e => { if (e.target === $("large")) $("large").close(); });
$("large").addEventListener("keydown", e => { if (e.key === "ArrowLeft") show(-1); if (e.key === "ArrowRight") show(1); });

function sortTable(table, column, head) {
  const up = head.getAttribute("aria-sort") !== "ascending" ;
  table.querySelectorAll("th").forEach(h => h.hasAttribute("aria-sort") && h.setAttribute("aria-sort", "none"));
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = b => b.querySelector("tr.parent").cells[column].dataset.v;
  const order = (a, b) => { const x = key(a), y = key(b), n = x - y; return (isNaN(n) ? x.localeCompare(y) : n) * (up ? 1 : -1); };
  [...table.tBodies].sort(order).forEach(b => table.append(b));
}
document.querySelectorAll("table.sortable").forEach(table => {
  [...table.tHead.rows[0].cells].forEach((head, i) => {
    head.tabIndex = 0;
    head.onclick = () => sortTable(table, i, head);
    head.onkeydown = e => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); sortTable(table, i, head); } };
  });
  table.addEventListener("click", e => {
    const b = e.target.closest("button.more");
    if (!b) return;
    const open = b.getAttribute("aria-expanded") !== "true";
    b.setAttribute("aria-expanded", String(open));
    b.closest("tbody").querySelectorAll("tr.child").forEach(r => r.hidden = !open);
  });
});
document.querySelectorAll("[data-filter]").forEach(box => {
  let table = box;
  while (!(table = table.nextElementSibling).matches(".scroll"));
  table = table.querySelector("table");
  box.onclick = e => {
    const b = e.target.closest("button");
    if (!b) return;
    box.querySelectorAll("button").forEach(x => x.setAttribute("aria-pressed", String(x === b)));
    table.dataset["want" + box.dataset.filter] = b.dataset.value;
    for (const body of table.tBodies)
      body.hidden = ["class", "against"].some(k => { const want = table.dataset["want" + k]; return want && body.dataset[k] !== undefined && body.dataset[k] !== want; });
  };
  table.dataset.wantclass = table.querySelector("tbody:not([hidden])")?.dataset.class ?? "";
});

const root = document.documentElement.style;
$("hole-colour").oninput = e => root.setProperty("--hole", e.target.value);
$("full-scale").textContent = percent(D.differenceFullScale);
buttons("pick-shift", D.shifts.map(s => [s.name, s.label]), "shift", draw);
buttons("pick-method", D.methods.map(m => [m, D.methodNames[m]]), "method", draw);
buttons("pick-compare", D.cameras.map(c => [c, c]), "compare", drawSlider);
if (D.arms.length) {
  buttons("pick-arm", D.arms.map(a => [a.name, a.label]), "arm", drawFills);
  buttons("pick-fill-camera", D.cameras.map(c => [c, c]), "fillCamera", drawFills);
}
buttons("pick-error", D.cameras.map(c => [c, c]), "error", drawErrors);
frameMenu();
draw();
