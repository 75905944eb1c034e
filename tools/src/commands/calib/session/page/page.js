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

tableCard();
follow();
