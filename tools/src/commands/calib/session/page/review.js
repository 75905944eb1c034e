"use strict";
// The result: residuals, views and figures; `page.js` has the state.

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
  const clocks = (r.order || []).filter((n) => r.cameras[n].exposed_later_s).map((n) => {
    const k = r.cameras[n].exposed_later_s;
    return element("tr", {}, element("td", {}, n), element("td", {}, `${(1000 * Math.abs(k.value)).toFixed(1)} ms ${k.value > 0 ? "later" : "earlier"} than stamped`), element("td", { class: "sd" }, `± ${(1000 * k.sd).toFixed(1)}`));
  });
  if (clocks.length) card("Clocks that are off", element("table", {}, ...clocks));
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
