"use strict";
// The page of a calibration session. It shows what `state` says, and posts commands to `act`; the session itself
// lives in the program that serves this page.

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const TASKS = { mono: "Lenses", rig: "Poses", table: "Table" };
const STEPS = [["preview", "Preview"], ["gathering", "Gather"], ["processing", "Process"], ["review", "Review"], ["saved", "Save"]];

let state = null;   // what the server said last
let result = null;  // the result that is reviewed
let resultOf = "";  // which result that is
let chosen = { camera: 0, view: null, lens: "raw" };
let reviewing = false;

function element(tag, attributes = {}, ...children) {
  const e = document.createElement(tag);
  for (const [k, v] of Object.entries(attributes)) {
    if (k === "onclick") e.addEventListener("click", v);
    else if (v !== false && v !== null && v !== undefined) e.setAttribute(k, v === true ? "" : v);
  }
  e.append(...children);
  return e;
}

function shape(tag, attributes) {
  const e = document.createElementNS(SVG, tag);
  for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v);
  return e;
}

async function act(command) {
  $("trouble").hidden = true;
  try {
    const answer = await fetch("act", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command) });
    if (!answer.ok) trouble(await answer.text());
  } catch {
    trouble("The session does not answer.");
  }
}

function trouble(text) {
  $("trouble").textContent = text;
  $("trouble").hidden = false;
}

// ---- state ----

async function follow() {
  let version = 0;
  for (;;) {
    try {
      const answer = await fetch(`state?after=${version}`);
      if (!answer.ok) throw new Error(await answer.text());
      state = await answer.json();
      version = state.version;
      $("lost").hidden = true;
      await show();
    } catch (e) {
      $("lost").textContent = `The session does not answer (${e.message}). Start it again and open the address that it prints; nothing that was kept is lost.`;
      $("lost").hidden = false;
      await new Promise((done) => setTimeout(done, 1000));
    }
  }
}

async function show() {
  const s = state.session;
  const was = reviewing;
  reviewing = s.has_result && ["review", "saved"].includes(s.phase);
  const key = `${s.task}/${s.has_result}/${s.stale}/${s.phase === "processing"}`;
  if (reviewing && (key !== resultOf || !was)) {
    const answer = await fetch("result");
    result = answer.ok ? await answer.json() : null;
    resultOf = key;
    const all = result ? result.cameras : [];
    if (chosen.camera >= all.length) chosen.camera = 0;
    if (all.length && !all[chosen.camera].views.some((v) => v.name === chosen.view)) chosen.view = worst(all[chosen.camera]);
  }
  reviewing = reviewing && result !== null;
  showHead(s);
  showCameras(s);
  showReview(s);
  showStrip(s);
  showAside(s);
  document.body.dataset.phase = s.phase;
  document.body.dataset.task = s.task;
}

function worst(camera) {
  const sorted = [...camera.views].sort((a, b) => b.rms_px - a.rms_px);
  return sorted.length ? sorted[0].name : null;
}

function showHead(s) {
  $("tasks").replaceChildren(...state.tasks.map((t) =>
    element("button", { type: "button", "aria-pressed": String(t.task === s.task), onclick: () => act({ do: "task", task: t.task }) },
      TASKS[t.task], element("small", {}, t.phase === "saved" ? "saved" : t.views ? `${t.views}` : ""))));
  const now = STEPS.findIndex(([phase]) => phase === s.phase);
  $("steps").replaceChildren(...STEPS.map(([, name], i) =>
    element("li", { class: i === now ? "now" : i < now ? "done" : "" }, name)));
  const from = { live: "running rig", recording: "recording", pictures: "pictures" }[state.source.kind];
  const at = state.source.position ? ` ${state.source.position[0]} of ${state.source.position[1]}` : "";
  const about = [["Rig file", state.rig], ["Board", state.board], ["Source", from + at]];
  $("about").replaceChildren(...about.map(([k, v]) => element("div", {}, element("dt", {}, k), element("dd", { title: v }, v))));
}

// ---- cameras ----

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

// ---- what was kept ----

const thumbs = new Map();

function showStrip(s) {
  const figures = s.kept.map((shot) => {
    const key = `${s.task}/${shot.name}`;
    if (!thumbs.has(key)) {
      const camera = s.cameras[shot.corners.findIndex((n) => n !== null)];
      const url = `view?shot=${encodeURIComponent(shot.name)}&camera=${encodeURIComponent(camera.name)}&width=160`;
      thumbs.set(key, element("figure", { title: `${shot.name}: ${shot.corners.map((n, i) => (n === null ? "" : `${n} corners in ${s.cameras[i].name}`)).filter(Boolean).join(", ")}`, onclick: () => choose(shot.name) },
        element("img", { src: url, alt: "", loading: "lazy" }), element("figcaption", {}, shot.name.replace(/^trigger\d*(?=\d{5})/, "…")),
        element("button", { type: "button", title: "Leave this view out", "aria-label": `Leave ${shot.name} out`, onclick: (e) => { e.stopPropagation(); act({ do: "drop", view: shot.name }); } }, "×")));
    }
    return thumbs.get(key);
  });
  const strip = $("strip");
  const same = strip.children.length === figures.length && figures.every((f, i) => f === strip.children[i]);
  if (!same) {
    strip.replaceChildren(...figures);
    strip.scrollLeft = strip.scrollWidth;
  }
}

function choose(view) {
  if (!reviewing) return;
  const c = result.cameras[chosen.camera];
  if (!c.views.some((v) => v.name === view)) {
    const other = result.cameras.findIndex((o) => o.views.some((v) => v.name === view));
    if (other < 0) return;
    chosen.camera = other;
  }
  chosen.view = view;
  showReview(state.session);
  showAside(state.session);
}

// ---- review ----

function showReview() {
  $("review").hidden = !reviewing;
  if (!reviewing) return;
  const camera = result.cameras[chosen.camera];
  const view = camera.views.find((v) => v.name === chosen.view) || camera.views[0];
  $("review-cameras").replaceChildren(...result.cameras.map((c, i) =>
    element("button", { type: "button", "aria-pressed": String(i === chosen.camera), onclick: () => { chosen.camera = i; if (!c.views.some((v) => v.name === chosen.view)) chosen.view = worst(c); showReview(); showAside(state.session); } }, c.name)));
  for (const b of $("lens").children) {
    b.setAttribute("aria-pressed", String(b.dataset.lens === chosen.lens));
    b.onclick = () => { chosen.lens = b.dataset.lens; showReview(); };
  }
  $("leave-out").onclick = () => view && act({ do: "drop", view: view.name });
  $("leave-out").disabled = !view || state.session.phase === "processing";
  if (!view) return;
  const lens = chosen.lens === "undistorted" ? "&undistorted=1" : "";
  // Marks were pointed at in the live picture; there is no kept one.
  const src = view.name === "marks" ? `picture?camera=${encodeURIComponent(camera.name)}&width=1920`
    : `view?shot=${encodeURIComponent(view.name)}&camera=${encodeURIComponent(camera.name)}${lens}`;
  const frame = $("review-frame");
  let img = frame.querySelector("img");
  if (!img || img.getAttribute("src") !== src) {
    img = element("img", { src, alt: `View ${view.name} of ${camera.name}` });
    frame.replaceChildren(img);
    if (!lens) frame.append(arrows(camera, view));
  }
  const scale = magnification(camera, view);
  $("review-caption").textContent = `${camera.name}, view ${view.name}: ${view.rms_px.toFixed(3)} px RMS, largest ${view.max_px.toFixed(2)} px, ${view.points.length} corners. ` +
    (lens ? "As a lens without distortion would have seen it: straight lines are straight." : `Red: observed − predicted, ${scale} times enlarged.`);
  bars(camera, view);
}

function magnification(camera, view) {
  const wanted = (0.02 * camera.size[0]) / Math.max(view.rms_px, 1e-3);
  const nice = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
  return nice.filter((n) => n <= wanted).pop() || 1;
}

function arrows(camera, view) {
  const [w, h] = camera.size;
  const svg = shape("svg", { viewBox: `-0.5 -0.5 ${w} ${h}`, preserveAspectRatio: "xMidYMid meet" });
  const scale = magnification(camera, view), stroke = w / 640;
  for (const [u, v, du, dv] of view.points) {
    svg.append(shape("line", { class: "residual", x1: u, y1: v, x2: u + scale * du, y2: v + scale * dv, "stroke-width": 1.6 * stroke }));
    svg.append(shape("circle", { class: "point", cx: u, cy: v, r: 1.8 * stroke }));
  }
  return svg;
}

function bars(camera, current) {
  const most = Math.max(...camera.views.map((v) => v.rms_px), 1e-6);
  const sorted = camera.views.map((v) => v.rms_px).sort((a, b) => a - b);
  const median = sorted[Math.floor(sorted.length / 2)] || 0;
  const line = element("span", {}, `median ${median.toFixed(3)} px`);
  line.style.bottom = `${(76 * median) / most}px`;
  $("bars").replaceChildren(line, ...camera.views.map((v) => {
    const b = element("button", {
      type: "button", title: `${v.name}: ${v.rms_px.toFixed(3)} px`, "aria-label": `View ${v.name}, ${v.rms_px.toFixed(3)} px`,
      "aria-pressed": String(v.name === current.name), class: v.rms_px > 2 * median ? "worst" : "", onclick: () => choose(v.name),
    });
    b.style.height = `${Math.max(3, (76 * v.rms_px) / most)}px`;
    return b;
  }));
}

// ---- the side ----

function showAside(s) {
  $("advice-text").textContent = s.advice;
  sketch(s.next);
  $("progress").hidden = !state.step;
  if (state.step) {
    $("progress").querySelector("p").textContent = state.step[0];
    $("progress").querySelector("progress").value = state.step[1];
  }
  const failure = state.trouble || s.failure;
  if (failure) trouble(failure);
  buttons(s);
  $("counters").hidden = reviewing;
  if (!reviewing) counters(s);
  $("figures").hidden = !reviewing;
  if (reviewing) figures();
}

function buttons(s) {
  const button = (text, command, enabled, look = "") =>
    element("button", { type: "button", class: look, disabled: !enabled, id: `do-${command.do}`, onclick: () => act(command) }, text);
  const busy = s.phase === "processing", any = s.kept.length + s.marks.length > 0;
  const ended = state.source.ended;
  const all = [];
  if (s.phase === "gathering") all.push(button("Pause", { do: "pause" }, true, "wide"));
  else if (reviewing && !s.stale) all.push(button(s.phase === "saved" ? "Saved to the rig file" : "Save to the rig file", { do: "save" }, s.phase !== "saved", "wide main"));
  else if (s.stale || (ended && any)) all.push(button(s.stale ? "Process again" : "Process", { do: "process" }, any && !busy, "wide main"));
  else all.push(button(any ? "Go on gathering" : "Start gathering", { do: "gather" }, !busy && !ended, "wide main"));
  if (reviewing || (ended && any)) { if (!ended) all.push(button("Gather more", { do: "gather" }, !busy)); }
  else all.push(button("Process", { do: "process" }, any && !busy, s.next.do === "process" ? "main" : ""));
  all.push(button("Undo last view", { do: "undo" }, any && !busy, all.length === 1 ? "wide" : ""));
  const key = all.map((b) => b.outerHTML).join();
  // Buttons that stay as they are keep the focus and the press that is under way.
  if ($("buttons").dataset.key !== key) {
    $("buttons").dataset.key = key;
    $("buttons").replaceChildren(...all);
  }
}

function bar(share) {
  const inner = element("div");
  inner.style.width = `${Math.round(100 * share)}%`;
  return element("div", { class: share > 0.995 ? "bar full" : "bar", role: "img", "aria-label": `${Math.round(100 * share)} %` }, inner);
}

function counters(s) {
  const reasons = [...new Set(s.cameras.flatMap((c) => Object.keys(c.tally)))].sort();
  const rows = [
    element("tr", {}, element("th", {}, ""), ...s.cameras.map((c) => element("th", {}, c.name))),
    element("tr", {}, element("td", {}, "gathered"), ...s.cameras.map((c) => element("td", {}, bar(c.reached)))),
    element("tr", { class: "kept" }, element("td", {}, "views kept"), ...s.cameras.map((c) => element("td", {}, `${c.views}`))),
    element("tr", {}, element("td", {}, "rejected"), ...s.cameras.map((c) => element("td", {}, `${Object.values(c.tally).reduce((a, b) => a + b, 0)}`))),
    ...reasons.map((r) => element("tr", { class: "why" }, element("td", {}, `– ${r}`), ...s.cameras.map((c) => element("td", {}, `${c.tally[r] || ""}`)))),
  ];
  $("counters").replaceChildren(element("table", {}, ...rows));
}

function sketch(next) {
  const svg = $("sketch");
  svg.replaceChildren(shape("rect", { class: "picture", x: 1, y: 1, width: 94, height: 62, rx: 4 }));
  const sheet = (points, kind = "sheet") => svg.append(shape("polygon", { class: kind, points }));
  const rect = (cx, cy, w, h, kind) => sheet(`${cx - w / 2},${cy - h / 2} ${cx + w / 2},${cy - h / 2} ${cx + w / 2},${cy + h / 2} ${cx - w / 2},${cy + h / 2}`, kind);
  const sign = (d) => svg.append(shape("path", { class: "sign", d }));
  switch (next.do) {
    case "move-to": rect(20 + 28 * next.place.column, 14 + 18 * next.place.row, 28, 19); break;
    case "tilt": sheet({ left: "28,20 70,10 70,54 28,44", right: "26,10 68,20 68,44 26,54", top: "34,16 62,16 74,50 22,50", bottom: "22,14 74,14 62,48 34,48" }[next.edge]); break;
    case "closer": rect(48, 32, 76, 48); break;
    case "farther": rect(48, 32, 24, 15); break;
    case "hold-still": rect(48, 32, 44, 28, "dash"); sign("M42 26v12M54 26v12"); break;
    case "process": case "review": case "done": case "all-looked-at": sign("M34 33l10 10 20-22"); break;
    case "wait": sign("M40 22h16l-8 10 8 10h-16l8-10z"); break;
    case "show-to-both": rect(28, 32, 30, 20); rect(68, 32, 30, 20, "dash"); break;
    case "lay-on-table": sheet("34,22 62,22 78,46 18,46"); break;
    case "focus": rect(48, 32, 44, 28, "dash"); break;
    default: rect(48, 32, 44, 28, "dash");
  }
}

function figures() {
  const r = result.report, camera = result.cameras[chosen.camera], own = r.cameras[camera.name];
  const cards = [];
  const card = (title, ...content) => cards.push(element("div", { class: "card" }, title ? element("h3", {}, title) : "", ...content));
  const notes = [`corners in ${Math.round(100 * own.coverage)} % of the picture`];
  if (own.cross_validation) notes.push(`views left out fit to ${own.cross_validation.held_out_rms_px.toFixed(3)} px: more views would ${own.cross_validation.more_frames_help ? "" : "not "}help`);
  card("", element("p", { class: "big" }, `${own.rms_px.toFixed(3)} px `, element("small", {}, `RMS, ${camera.name}, ${own.views.length} views`)), element("p", {}, `${notes.join("; ")}.`));
  if (r.baseline_m) {
    const [x, y, z] = r.T.map((v) => (1000 * v).toFixed(2));
    card("Pose of the second camera", element("table", {},
      element("tr", {}, element("td", {}, "distance"), element("td", {}, `${(1000 * r.baseline_m.value).toFixed(2)} ± ${(1000 * r.baseline_m.sd).toFixed(2)} mm`)),
      element("tr", {}, element("td", {}, "T"), element("td", {}, `${x}, ${y}, ${z} mm`)),
      element("tr", {}, element("td", {}, "RMS, both cameras"), element("td", {}, `${r.rms_px.toFixed(3)} px`))));
  } else if (r.kind === "table") {
    const sd = r.pose_sd.map((v, i) => (i < 3 ? `${((v * 180) / Math.PI).toFixed(3)}°` : `${(1000 * v).toFixed(2)} mm`));
    card("The table", element("table", {},
      ...["x", "y", "z"].map((n, i) => element("tr", {}, element("td", {}, `middle, ${n} in ${result.cameras[0].name}`), element("td", {}, `${(1000 * r.T[i]).toFixed(1)} mm`), element("td", { class: "sd" }, `± ${sd[3 + i]}`))),
      element("tr", {}, element("td", {}, "turn"), element("td", {}, ""), element("td", { class: "sd" }, `± ${sd.slice(0, 3).sort().pop()}`))));
  } else if (r.kind === "rig") {
    card("Poses", element("table", {}, ...r.order.map((n) => element("tr", {}, element("td", {}, n), element("td", {}, `${(1000 * Math.hypot(...r.cameras[n].T)).toFixed(1)} mm from ${r.order[0]}`)))));
  }
  if (r.rejected.length) card("Views that contradict the others", ...r.rejected.map((v) => element("p", {}, `${v.view}: ${v.reason}`)));
  const digits = { f: 2, c: 2, k: 4, p: 5 };
  const names = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];
  const parameters = element("table", {}, ...names.map((n) => {
    const p = own.parameters[n], d = digits[n[0]];
    return element("tr", {}, element("td", {}, n), element("td", {}, p.value.toFixed(d)), element("td", { class: "sd" }, p.sd ? `± ${p.sd.toFixed(d)}` : "fixed"));
  }));
  card("Errors of all corners", scatter(camera));
  if (r.kind !== "table") card("Lens", parameters);
  if (own.projection_sd_px && own.projection_sd_px.length) card("Uncertainty of a pixel over the picture", uncertainty(camera, own.projection_sd_px));
  $("figures").replaceChildren(...cards);
}

function scatter(camera) {
  const points = camera.views.flatMap((v) => v.points.map(([, , x, y]) => [x, y, v.name === chosen.view]));
  const lengths = points.map(([x, y]) => Math.hypot(x, y)).sort((a, b) => a - b);
  const reach = Math.max(lengths[Math.floor(0.995 * (lengths.length - 1))] || 0, 1e-3) * 1.1;
  const ring = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((r) => r > 0.45 * reach) || reach;
  const svg = shape("svg", { class: "plot", viewBox: "-110 -84 220 168" });
  const k = 80 / reach;
  svg.append(shape("line", { class: "axis", x1: -106, y1: 0, x2: 106, y2: 0 }), shape("line", { class: "axis", x1: 0, y1: -82, x2: 0, y2: 82 }), shape("circle", { class: "axis", r: ring * k }));
  for (const mine of [false, true]) {
    for (const [x, y, own] of points) {
      if (own === mine && Math.hypot(x, y) <= reach * 1.3) svg.append(shape("circle", { class: mine ? "dot mine" : "dot", cx: x * k, cy: y * k, r: 1.3 }));
    }
  }
  const label = shape("text", { x: ring * k * 0.72 + 2, y: -ring * k * 0.72 - 2 });
  label.textContent = `${ring} px`;
  svg.append(label);
  return svg;
}

function uncertainty(camera, cells) {
  const [w, h] = camera.size;
  const svg = shape("svg", { class: "plot", viewBox: `0 0 ${w} ${h}` });
  const columns = new Set(cells.map((c) => c[0])).size, rows = new Set(cells.map((c) => c[1])).size;
  const values = cells.map((c) => c[2]).sort((a, b) => a - b);
  for (const [u, v, sd] of cells) {
    // From a tenth of a pixel (light) to three pixels (dark), evenly in the logarithm.
    const t = Math.min(1, Math.max(0, Math.log(sd / 0.03) / Math.log(100)));
    const cell = shape("rect", { x: u + 0.5 - w / columns / 2, y: v + 0.5 - h / rows / 2, width: w / columns + 1, height: h / rows + 1, fill: `hsl(${210 - 180 * t} 70% ${92 - 42 * t}%)` });
    const title = shape("title", {});
    title.textContent = `${sd.toFixed(3)} px`;
    cell.append(title);
    svg.append(cell);
  }
  const middle = values[Math.floor(values.length / 2)] || 0, last = values[values.length - 1] || 0;
  return element("div", {}, svg, element("p", {}, `Standard deviation of a far point's pixel: ${values[0].toFixed(3)} px at best, ${middle.toFixed(3)} px in the middle of all, ${last.toFixed(2)} px at worst.`));
}

tableCard();
follow();
