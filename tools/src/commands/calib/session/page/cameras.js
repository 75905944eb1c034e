"use strict";
// The cameras' pictures with what is drawn over them, and the table's marks; `page.js` has the state.

const panes = new Map();

function pane(name) {
  if (panes.has(name)) return panes.get(name);
  const img = element("img", { alt: "" });
  const svg = shape("svg", { preserveAspectRatio: "xMidYMid meet" });
  const empty = element("p", { class: "empty" }, "No picture yet");
  const views = element("span", { class: "views" });
  const verdict = element("span", { class: "verdict" });
  const frame = element("div", { class: "frame" }, empty, img, svg);
  const map = shape("svg", { class: "map" });
  const aims = element("ul");
  const root = element("div", { class: "camera" },
    element("div", { class: "head" }, element("h2", {}, name), views, verdict), frame,
    element("div", { class: "aims" }, element("figure", {}, map, element("figcaption", {}, "where corners were")), aims));
  const p = { root, img, svg, empty, views, verdict, frame, map, aims, loading: 0, drawn: -1 };
  panes.set(name, p);
  pointing(p, name);
  return p;
}

function showCameras(s) {
  $("cameras").hidden = reviewing;
  if (reviewing) {
    showTable(s);
    return;
  }
  const count = s.cameras.length;
  $("cameras").style.gridTemplateColumns = `repeat(${count === 1 ? 1 : count <= 4 ? 2 : count <= 9 ? 3 : 4}, minmax(0, 1fr))`;
  $("cameras").dataset.count = count;
  const roots = s.cameras.map((c) => pane(c.name).root);
  if ([...$("cameras").children].some((e, i) => e !== roots[i]) || $("cameras").children.length !== count) $("cameras").replaceChildren(...roots);
  for (const camera of s.cameras) {
    const p = pane(camera.name);
    p.views.textContent = camera.views === 1 ? "1 view" : `${camera.views} views`;
    p.verdict.className = `verdict ${camera.good ? "good" : "bad"}`;
    p.verdict.textContent = camera.good ? (s.phase === "gathering" ? "kept" : "good view") : camera.rejected || "";
    p.verdict.title = p.verdict.textContent;
    p.empty.textContent = state.source.kind === "live" ? `No frames yet: is netcord capture --rig ${state.rig} running?` : "No picture yet";
    if (camera.size) p.frame.style.aspectRatio = camera.size.join("/");
    heatMap(p.map, camera);
    p.aims.replaceChildren(...camera.aims.map((a) =>
      element("li", { class: a.have >= a.want ? "met" : "" }, element("span", {}, a.name), bar(a.have / a.want), element("span", {}, `${Math.min(a.have, a.want)} of ${a.want}`))));
    picture(p, s, camera, state.shot);
  }
  showTable(s);
}

// Corners are drawn together with the picture that they were found in.
function picture(p, s, camera, shot) {
  if (!camera.size || p.loading > performance.now()) return;
  if (p.drawn === shot) {
    overlay(p.svg, s, camera);
    return;
  }
  p.loading = performance.now() + 2000;
  const next = element("img", { alt: `What camera ${camera.name} sees` });
  next.addEventListener("load", () => {
    p.loading = 0;
    p.drawn = shot;
    p.empty.hidden = true;
    p.img.replaceWith(next);
    p.img = next;
    overlay(p.svg, s, camera);
    const now = state.session.cameras.find((c) => c.name === camera.name);
    if (state.shot !== shot && now) picture(p, state.session, now, state.shot);
  });
  next.addEventListener("error", () => { p.loading = 0; });
  const wide = s.task === "table" ? "&width=1920" : ""; // marks are pointed at
  next.src = `picture?camera=${encodeURIComponent(camera.name)}&shot=${shot}${wide}`;
}

function heatMap(svg, camera) {
  const { columns, rows, counts } = camera.heat;
  const [w, h] = camera.size || [16, 10];
  const most = Math.max(...counts, 1);
  svg.setAttribute("viewBox", `0 0 ${w} ${h}`);
  svg.replaceChildren(shape("rect", { class: "ground", width: w, height: h }), ...counts.flatMap((n, i) => (n ? [shape("rect", {
    class: "heat", x: ((i % columns) * w) / columns, y: (Math.floor(i / columns) * h) / rows, width: w / columns, height: h / rows,
    "fill-opacity": 0.15 + 0.85 * Math.sqrt(n / most),
  })] : [])));
}

function overlay(svg, s, camera) {
  svg.replaceChildren();
  const [w, h] = camera.size;
  svg.setAttribute("viewBox", `-0.5 -0.5 ${w} ${h}`);
  const stroke = w / 480;
  if (s.next.do === "move-to" && s.next.camera === camera.name) {
    const { column, row } = s.next.place;
    svg.append(shape("rect", { class: "target", x: (column * w) / 3 + 4 * stroke, y: (row * h) / 3 + 4 * stroke, width: w / 3 - 8 * stroke, height: h / 3 - 8 * stroke, "stroke-width": 2 * stroke, rx: 6 * stroke }));
  }
  const good = camera.good ? " good" : "";
  if (camera.outline.length) {
    svg.append(shape("polygon", { class: `board${good}`, points: camera.outline.map((p) => p.join()).join(" "), "stroke-width": 1.4 * stroke }));
  }
  for (const mark of s.marks.filter((m) => m.camera === camera.name)) {
    const [x, y] = mark.at, r = 6 * stroke;
    svg.append(shape("path", { class: "mark", d: `M${x - r} ${y}h${2 * r}M${x} ${y - r}v${2 * r}`, "stroke-width": stroke }));
    const label = shape("text", { x: x + r, y: y - r, "font-size": 11 * stroke });
    label.textContent = mark.mark;
    svg.append(label);
  }
  for (const [x, y] of camera.corners) svg.append(shape("circle", { class: `corner${good}`, cx: x, cy: y, r: 2.6 * stroke, "stroke-width": 0.7 * stroke }));
}

// ---- the table ----

const MARKS = { "x-y-": [-1, -1], "x0y-": [0, -1], "x+y-": [1, -1], "x-y0": [-1, 0], "x0y0": [0, 0], "x+y0": [1, 0], "x-y+": [-1, 1], "x0y+": [0, 1], "x+y+": [1, 1] };
let marking = null; // the mark that the next click on a picture is for

function tableCard() {
  for (const [name, [x, y]] of Object.entries(MARKS)) {
    const b = element("button", { type: "button", title: name, "data-mark": name, "aria-label": `Mark ${name}`, onclick: () => { marking = marking === name ? null : name; showTable(state.session); } });
    // y grows away from the viewer: upwards in the sketch.
    b.style.left = `${50 + 38 * x}%`;
    b.style.top = `${50 - 42.8 * y}%`;
    $("marks").append(b);
  }
  $("do-clear-marks").addEventListener("click", () => act({ do: "clear-marks" }));
  $("place").addEventListener("submit", (e) => {
    e.preventDefault();
    const numbers = Object.fromEntries([...new FormData(e.target)].map(([k, v]) => [k, Number(v)]));
    act({ do: "place", ...numbers });
  });
}

function showTable(s) {
  const shown = s.task === "table" && !reviewing;
  $("table").hidden = !shown;
  document.body.classList.toggle("marking", shown && marking !== null);
  if (!shown) return;
  for (const b of $("marks").querySelectorAll("button")) {
    b.className = s.marks.some((m) => m.mark === b.dataset.mark) ? "set" : "";
    b.setAttribute("aria-pressed", String(b.dataset.mark === marking));
  }
  $("marks-text").textContent = marking
    ? `Click where ${marking} is in a picture: the outer edge of the white lines.`
    : s.marks.length ? `${s.marks.length} set; four in one camera are enough.` : "Choose a mark here, then click it in a picture. x+ is to the right, y+ at the top.";
  $("do-clear-marks").disabled = !s.marks.length;
  $("do-place").textContent = s.on_table ? "Used; change" : "Use";
}

// Where a pointer is in a camera's picture, px; nothing beside the picture.
function pixelAt(p, camera, event) {
  const box = p.frame.getBoundingClientRect(), [w, h] = camera.size;
  const scale = Math.min(box.width / w, box.height / h);
  const u = (event.clientX - box.left - (box.width - w * scale) / 2) / scale - 0.5;
  const v = (event.clientY - box.top - (box.height - h * scale) / 2) / scale - 0.5;
  return u > -0.5 && v > -0.5 && u < w - 0.5 && v < h - 0.5 ? [u, v] : null;
}

function pointing(p, name) {
  const camera = () => state.session.cameras.find((c) => c.name === name);
  const glass = element("canvas", { width: 150, height: 150, hidden: true });
  p.frame.append(glass);
  p.frame.addEventListener("pointermove", (e) => {
    const at = marking && state.session.task === "table" && camera().size ? pixelAt(p, camera(), e) : null;
    glass.hidden = !at;
    if (!at) return;
    // Eight screen pixels for one of the frame, beside the pointer.
    const box = p.frame.getBoundingClientRect(), x = e.clientX - box.left, y = e.clientY - box.top;
    glass.style.left = `${x > box.width / 2 ? x - 174 : x + 20}px`;
    glass.style.top = `${Math.max(0, Math.min(box.height - 154, y - 75))}px`;
    const context = glass.getContext("2d"), k = p.img.naturalWidth / camera().size[0], side = (150 / 8) * k;
    context.imageSmoothingEnabled = false;
    context.fillRect(0, 0, 150, 150);
    context.drawImage(p.img, (at[0] + 0.5) * k - side / 2, (at[1] + 0.5) * k - side / 2, side, side, 0, 0, 150, 150);
    context.strokeStyle = "#ffd54a";
    context.strokeRect(0, 75, 150, 0);
    context.strokeRect(75, 0, 0, 150);
  });
  p.frame.addEventListener("pointerleave", () => { glass.hidden = true; });
  p.frame.addEventListener("click", (e) => {
    const at = marking && state.session.task === "table" && camera().size ? pixelAt(p, camera(), e) : null;
    if (!at) return;
    act({ do: "mark", camera: name, mark: marking, at });
    marking = null;
    glass.hidden = true;
  });
}
