// The live map. No library and no build step: what stands here runs.
"use strict";

const TRAIL_S = 20;
const TRAIL_POINTS = 120;
const RETRY_FIRST_MS = 500;
const RETRY_LONGEST_MS = 10000;
const LOST_AFTER_MS = 3000;
const ERROR_BIN_M = 0.05;
const UNAUTHORIZED = 4401;
const FORBIDDEN = 4403;
const TOKEN_KEY = "fploc-token";
const REASONS = {
  fixed: "fixed", no_reading: "no reading", too_few_ranges: "too few ranges",
  degenerate_geometry: "access points in a line",
};

const at = (id) => document.getElementById(id);
const canvas = at("map");
const context = canvas.getContext("2d");
const view = { scale: 20, x: 0, y: 0 };
let site = null;
let planPictures = null;
const backdrop = { canvas: document.createElement("canvas"), drawn: "" };
let selected = null;
let moved = false;
let retryMs = RETRY_FIRST_MS;
let lastTickAt = 0;
let socket = null;
let socketNumber = 0;
const devices = new Map();
const errorBins = new Uint32Array(4000);
let errorCount = 0;
let errorSum = 0;
let errorNow = null;
let colours = {};

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ground", "panel", "ink", "faint", "line", "device", "silent", "ap", "truth", "selected"]) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
  colours.isDark = window.matchMedia("(prefers-color-scheme: dark)").matches;
}

function headers() {
  const token = sessionStorage.getItem(TOKEN_KEY);
  return token ? { Authorization: `Bearer ${token}` } : {};
}

async function get(path) {
  const response = await fetch(path, { headers: headers() });
  if (response.status === 401 || response.status === 403) { askForToken(response.status); throw new Error("token"); }
  if (!response.ok) { throw new Error(`${path}: ${response.status}`); }
  return response;
}

function askForToken(status) {
  const had = sessionStorage.getItem(TOKEN_KEY) !== null;
  at("token-form").hidden = false;
  at("token-problem").textContent = !had ? "" : status === 403 || status === FORBIDDEN
    ? "This token may not read." : "This token is unknown or has expired.";
  state("lost", "a token is needed");
  at("token").focus();
}

function state(name, text) {
  const element = at("connection");
  if (element.dataset.state !== name || element.textContent !== text) {
    element.dataset.state = name;
    element.textContent = text;
  }
}

// ---------------------------------------------------------------- places

function toScreen(x, y) { return [view.x + x * view.scale, view.y - y * view.scale]; }

function planCorners() {
  const n = site.plan.metres_from_pixels;
  const corner = (u, v) => [n[0][0] * u + n[0][1] * v + n[0][2], n[1][0] * u + n[1][1] * v + n[1][2]];
  const w = site.plan.width_px - 0.5, h = site.plan.height_px - 0.5;
  return [corner(-0.5, -0.5), corner(w, -0.5), corner(-0.5, h), corner(w, h)];
}

function fit() {
  const corners = planCorners();
  const xs = corners.map((c) => c[0]), ys = corners.map((c) => c[1]);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const w = canvas.clientWidth, h = canvas.clientHeight;
  view.scale = Math.min(w / (x1 - x0), (h - 110) / (y1 - y0)) * 0.95;
  view.x = w / 2 - view.scale * (x0 + x1) / 2;
  view.y = h / 2 + view.scale * (y0 + y1) / 2;
  redraw();
}

function zoom(factor, u, v) {
  const scale = Math.min(2000, Math.max(0.5, view.scale * factor));
  const real = scale / view.scale;
  view.x = u + (view.x - u) * real;
  view.y = v + (view.y - v) * real;
  view.scale = scale;
  redraw();
}

// ---------------------------------------------------------------- drawing

let asked = false;
function redraw() {
  if (asked) { return; }
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}

function resize() {
  const ratio = window.devicePixelRatio || 1;
  for (const one of [canvas, at("cdf")]) {
    one.width = Math.max(1, Math.round(one.clientWidth * ratio));
    one.height = Math.max(1, Math.round(one.clientHeight * ratio));
  }
  if (site && !moved) { fit(); } else { redraw(); }
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  drawBackdrop(ratio);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.drawImage(backdrop.canvas, 0, 0);
  if (!site) { return; }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  if (at("show-trails").checked) { drawTrails(); }
  if (at("show-ellipses").checked) { drawEllipses(); }
  if (at("show-truth").checked) { drawTruths(); }
  drawDots();
  drawScale();
}

// What stands still is drawn once, until the view or the choice changes.
function drawBackdrop(ratio) {
  const names = at("show-names").checked;
  const wanted = [site?.name, planPictures !== null, view.scale, view.x, view.y, canvas.width, canvas.height,
    colours.isDark, names].join();
  if (backdrop.drawn === wanted) { return; }
  backdrop.drawn = wanted;
  backdrop.canvas.width = canvas.width;
  backdrop.canvas.height = canvas.height;
  const ink = backdrop.canvas.getContext("2d");
  ink.fillStyle = colours.ground;
  ink.fillRect(0, 0, canvas.width, canvas.height);
  if (!site) { return; }
  ink.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawPlan(ink);
  for (const ap of site.access_points) { drawAccessPoint(ink, ap, names); }
}

function drawPlan(ink) {
  if (!planPictures) { return; }
  const n = site.plan.metres_from_pixels, s = view.scale;
  ink.save();
  ink.transform(n[0][0] * s, -n[1][0] * s, n[0][1] * s, -n[1][1] * s,
    view.x + n[0][2] * s, view.y - n[1][2] * s);
  ink.imageSmoothingEnabled = true;
  ink.imageSmoothingQuality = "high";
  ink.globalAlpha = colours.isDark ? 0.7 : 1;
  // Pixel centres are whole numbers: the picture begins half a pixel before them.
  ink.drawImage(colours.isDark ? planPictures.dark : planPictures.light, -0.5, -0.5);
  ink.restore();
}

// Bright lines on a dark floor.
function inverted(picture) {
  const copy = new OffscreenCanvas(picture.width, picture.height);
  const ink = copy.getContext("2d");
  ink.fillStyle = "#fff";
  ink.fillRect(0, 0, picture.width, picture.height);
  ink.drawImage(picture, 0, 0);
  ink.globalCompositeOperation = "difference";
  ink.fillRect(0, 0, picture.width, picture.height);
  return copy;
}

function drawAccessPoint(ink, ap, hasName) {
  const [u, v] = toScreen(ap.x_m, ap.y_m);
  ink.fillStyle = colours.ap;
  ink.beginPath();
  ink.moveTo(u, v - 7); ink.lineTo(u + 7, v); ink.lineTo(u, v + 7); ink.lineTo(u - 7, v);
  ink.fill();
  if (hasName) { label(ink, ap.name, u + 9, v + 4, colours.ap); }
}

function label(ink, text, u, v, colour) {
  ink.font = "12px system-ui, sans-serif";
  ink.lineWidth = 3;
  ink.strokeStyle = colours.ground;
  ink.strokeText(text, u, v);
  ink.fillStyle = colour;
  ink.fillText(text, u, v);
}

function isShown(device) { return device.now.x_m !== null; }

function drawTrails() {
  const now = performance.now();
  context.lineWidth = 1.5;
  for (const device of devices.values()) {
    if (device.trail.length < 2) { continue; }
    context.strokeStyle = device.name === selected ? colours.selected : colours.device;
    context.globalAlpha = 0.55;
    context.beginPath();
    let begun = false;
    for (const [x, y, when] of device.trail) {
      if (now - when > TRAIL_S * 1000) { continue; }
      const [u, v] = toScreen(x, y);
      if (begun) { context.lineTo(u, v); } else { context.moveTo(u, v); begun = true; }
    }
    context.stroke();
  }
  context.globalAlpha = 1;
}

function drawEllipses() {
  for (const device of devices.values()) {
    const ellipse = device.now.ellipse95;
    if (!isShown(device) || !ellipse) { continue; }
    const [u, v] = toScreen(device.now.x_m, device.now.y_m);
    context.strokeStyle = context.fillStyle = device.name === selected ? colours.selected : colours.device;
    context.lineWidth = device.name === selected ? 2 : 1;
    context.beginPath();
    context.ellipse(u, v, ellipse.semi_major_m * view.scale, ellipse.semi_minor_m * view.scale,
      -ellipse.angle_rad, 0, 2 * Math.PI);
    context.globalAlpha = 0.08; context.fill();
    context.globalAlpha = 0.8; context.stroke();
  }
  context.globalAlpha = 1;
}

function drawTruths() {
  context.strokeStyle = colours.truth;
  context.lineWidth = 2;
  for (const { now } of devices.values()) {
    if (now.truth_x_m === null) { continue; }
    const [u, v] = toScreen(now.truth_x_m, now.truth_y_m);
    context.strokeRect(u - 5, v - 5, 10, 10);
    if (now.x_m === null) { continue; }
    context.beginPath();
    context.moveTo(u, v); context.lineTo(...toScreen(now.x_m, now.y_m));
    context.globalAlpha = 0.6; context.stroke(); context.globalAlpha = 1;
  }
}

function drawDots() {
  const names = at("show-names").checked;
  for (const device of devices.values()) {
    if (!isShown(device)) { continue; }
    const [u, v] = toScreen(device.now.x_m, device.now.y_m);
    const isNow = device.now.reason === "fixed" && !device.now.is_silent;
    const colour = device.name === selected ? colours.selected : isNow ? colours.device : colours.silent;
    context.beginPath();
    context.arc(u, v, device.name === selected ? 8 : 6, 0, 2 * Math.PI);
    if (isNow) {
      context.fillStyle = colour; context.fill();
    } else {
      context.strokeStyle = colour; context.lineWidth = 2.5; context.stroke();
    }
    if (names && (devices.size <= 60 || device.name === selected)) {
      label(context, device.name, u + 9, v - 6, colours.ink);
    }
  }
}

function drawScale() {
  const wanted = 140 / view.scale;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const metres = power * [5, 2, 1].find((step) => step * power <= wanted);
  at("scale-bar").style.width = `${Math.round(metres * view.scale)}px`;
  at("scale-text").textContent = `${metres} m`;
}

// ---------------------------------------------------------------- list and panel

function text(element, value) { if (element.textContent !== value) { element.textContent = value; } }

function whereText(now) {
  if (now.x_m === null) { return REASONS[now.reason] ?? now.reason; }
  const place = `${now.x_m.toFixed(1)}, ${now.y_m.toFixed(1)} m`;
  if (now.is_silent) { return `${place} (silent)`; }
  return now.reason === "fixed" ? place : `${place} (${REASONS[now.reason] ?? now.reason})`;
}

function listItem(device) {
  const item = document.createElement("li");
  const button = document.createElement("button");
  button.type = "button";
  button.setAttribute("aria-pressed", "false");
  const name = document.createElement("span");
  name.textContent = device.name;
  device.whereElement = document.createElement("span");
  device.whereElement.className = "where";
  button.append(name, device.whereElement);
  button.addEventListener("click", () => select(selected === device.name ? null : device.name));
  item.append(button);
  device.button = button;
  return item;
}

function updateList() {
  text(at("device-count"), `(${devices.size})`);
  for (const device of devices.values()) {
    if (!device.button) { at("devices").append(listItem(device)); }
    text(device.whereElement, whereText(device.now));
  }
  updatePanel();
  updateErrors();
}

function select(name) {
  selected = name;
  for (const device of devices.values()) {
    device.button?.setAttribute("aria-pressed", String(device.name === name));
  }
  at("panel").hidden = name === null;
  at("panel-readings").replaceChildren();
  updatePanel();
  updateReadings();
  redraw();
}

function updatePanel() {
  const device = devices.get(selected);
  if (!device) { return; }
  const { now } = device;
  const ellipse = now.ellipse95;
  const rows = [
    ["position", now.x_m === null ? "none yet" : `${now.x_m.toFixed(2)}, ${now.y_m.toFixed(2)} m`],
    ["95 % ellipse", ellipse ? `${ellipse.semi_major_m.toFixed(1)} × ${ellipse.semi_minor_m.toFixed(1)} m` : "none"],
    ["latest reading set", REASONS[now.reason] ?? now.reason],
    ["age of the fix", now.age_ms === null ? "none" : `${(now.age_ms / 1000).toFixed(1)} s`],
    ["access points", String(now.access_points)],
    ["method", `${now.method}, for people at ${site.speed_prior_mps} m/s`],
    ["recording", now.recording || "none"],
  ];
  if (now.truth_x_m !== null && now.x_m !== null) {
    rows.push(["error", `${Math.hypot(now.x_m - now.truth_x_m, now.y_m - now.truth_y_m).toFixed(2)} m`]);
  }
  text(at("panel-heading"), device.name);
  const list = at("panel-values");
  while (list.children.length > 2 * rows.length) { list.lastChild.remove(); }
  while (list.children.length < 2 * rows.length) {
    list.append(document.createElement("dt"), document.createElement("dd"));
  }
  rows.forEach(([name, value], index) => {
    text(list.children[2 * index], name);
    text(list.children[2 * index + 1], value);
  });
}

async function updateReadings() {
  const name = selected;
  if (name === null || !site) { return; }
  try {
    const response = await get(`/v1/sites/${encodeURIComponent(site.name)}/devices/${encodeURIComponent(name)}`);
    const detail = await response.json();
    if (name !== selected) { return; }
    const body = at("panel-readings");
    body.replaceChildren(...detail.readings.map((reading) => {
      const row = document.createElement("tr");
      for (const value of [reading.name, reading.range_m?.toFixed(2) ?? "–", reading.rss_dbm?.toFixed(0) ?? "–"]) {
        const cell = document.createElement("td");
        cell.textContent = value;
        row.append(cell);
      }
      row.title = reading.bssid;
      return row;
    }));
  } catch { /* the state of the connection is shown already */ }
}

// ---------------------------------------------------------------- error against ground truth

function countError(now) {
  const error = Math.hypot(now.x_m - now.truth_x_m, now.y_m - now.truth_y_m);
  errorBins[Math.min(errorBins.length - 1, Math.floor(error / ERROR_BIN_M))] += 1;
  errorCount += 1;
  errorSum += error * error;
  errorNow = error;
}

function quantile(share) {
  let below = 0;
  for (let bin = 0; bin < errorBins.length; bin += 1) {
    below += errorBins[bin];
    if (below >= share * errorCount) { return (bin + 0.5) * ERROR_BIN_M; }
  }
  return NaN;
}

function updateErrors() {
  if (errorCount === 0) { return; }
  if (at("error-section").hidden) {
    at("error-section").hidden = at("truth-choice").hidden = at("truth-legend").hidden = false;
    resize();
  }
  text(at("error-text"), `now ${errorNow.toFixed(2)}\u00a0m; RMSE ${Math.sqrt(errorSum / errorCount).toFixed(2)}\u00a0m, median `
    + `${quantile(0.5).toFixed(2)}\u00a0m, 90\u00a0% below ${quantile(0.9).toFixed(2)}\u00a0m (${errorCount} fixes)`);
  drawCdf();
}

function drawCdf() {
  const box = at("cdf"), ink = box.getContext("2d"), ratio = window.devicePixelRatio || 1;
  const w = box.clientWidth, h = box.clientHeight, left = 38, bottom = h - 22;
  ink.setTransform(ratio, 0, 0, ratio, 0, 0);
  ink.clearRect(0, 0, w, h);
  const longest = Math.max(2, Math.ceil(quantile(0.98)));
  const u = (error) => left + (w - left - 8) * error / longest, v = (share) => bottom - (bottom - 8) * share;
  ink.font = "11px system-ui, sans-serif";
  ink.fillStyle = colours.faint; ink.strokeStyle = colours.line; ink.lineWidth = 1;
  for (const share of [0, 0.5, 1]) {
    ink.beginPath(); ink.moveTo(left, v(share)); ink.lineTo(w - 8, v(share)); ink.stroke();
    ink.fillText(`${share * 100} %`, 0, v(share) + 4);
  }
  for (let error = 0; error <= longest; error += Math.max(1, Math.round(longest / 4))) {
    ink.fillText(`${error} m`, Math.min(u(error) - 8, w - 26), h - 6);
  }
  ink.strokeStyle = colours.truth; ink.lineWidth = 2;
  ink.beginPath(); ink.moveTo(left, bottom);
  let below = 0;
  for (let bin = 0; (bin + 1) * ERROR_BIN_M <= longest; bin += 1) {
    below += errorBins[bin];
    ink.lineTo(u((bin + 1) * ERROR_BIN_M), v(below / errorCount));
  }
  ink.stroke();
}

// ---------------------------------------------------------------- live

function take(message) {
  lastTickAt = performance.now();
  const seen = new Set();
  for (const now of message.devices) {
    seen.add(now.device);
    let device = devices.get(now.device);
    if (!device) { device = { name: now.device, now, trail: [] }; devices.set(now.device, device); }
    const isNew = device.now.t_ms !== now.t_ms || device.now.recording !== now.recording || device.trail.length === 0;
    if (device.now.recording !== now.recording) { device.trail.length = 0; }
    device.now = now;
    if (isNew && now.reason === "fixed" && now.x_m !== null) {
      device.trail.push([now.x_m, now.y_m, lastTickAt]);
      if (device.trail.length > TRAIL_POINTS) { device.trail.shift(); }
      if (now.truth_x_m !== null) { countError(now); }
    }
  }
  for (const [name, device] of devices) {
    if (seen.has(name)) { continue; }
    device.button?.parentElement.remove();
    devices.delete(name);
    if (name === selected) { select(null); }
  }
  if (message.is_overloaded) { state("overloaded", "overloaded: positions come late"); } else { state("live", "live"); }
  redraw();
}

function connect() {
  const number = (socketNumber += 1);
  const token = sessionStorage.getItem(TOKEN_KEY);
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const protocols = token ? ["fploc.v1", `bearer.${token}`] : ["fploc.v1"];
  socket = new WebSocket(`${scheme}://${location.host}/v1/sites/${encodeURIComponent(site.name)}/live`, protocols);
  socket.addEventListener("message", (event) => {
    if (number !== socketNumber) { return; }
    retryMs = RETRY_FIRST_MS;
    take(JSON.parse(event.data));
  });
  socket.addEventListener("close", (event) => {
    if (number !== socketNumber) { return; }
    if (event.code === UNAUTHORIZED || event.code === FORBIDDEN) { askForToken(event.code); return; }
    later(connect);
  });
}

function later(action) {
  state("lost", `connection lost: trying again`);
  setTimeout(action, retryMs * (0.75 + 0.5 * Math.random()));
  retryMs = Math.min(RETRY_LONGEST_MS, 2 * retryMs);
}

async function open(name) {
  socketNumber += 1;
  socket?.close();
  devices.clear();
  at("devices").replaceChildren();
  errorBins.fill(0);
  errorCount = errorSum = 0;
  select(null);
  const root = `/v1/sites/${encodeURIComponent(name)}`;
  site = await (await get(`${root}/site`)).json();
  const picture = await createImageBitmap(await (await get(site.plan.url)).blob());
  planPictures = { light: picture, dark: inverted(picture) };
  backdrop.drawn = "";
  text(at("site-name"), site.name);
  at("made-up").hidden = !site.is_made_up;
  document.title = `${site.name} – fploc live map`;
  moved = false;
  resize();
  connect();
}

async function begin() {
  try {
    const names = await (await get("/v1/sites")).json();
    at("token-form").hidden = true;
    const choice = at("site-select");
    choice.replaceChildren(...names.map((name) => new Option(name, name)));
    at("site-choice").hidden = names.length < 2;
    const wanted = new URLSearchParams(location.search).get("site");
    choice.value = names.includes(wanted) ? wanted : names[0];
    await open(choice.value);
  } catch (error) {
    if (error.message !== "token") { later(begin); }
  }
}

// ---------------------------------------------------------------- hands

function listen() {
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault(); moved = true;
    zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
  }, { passive: false });
  let grip = null;
  canvas.addEventListener("pointerdown", (event) => {
    grip = { u: event.offsetX, v: event.offsetY, far: false };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!grip) { return; }
    const du = event.offsetX - grip.u, dv = event.offsetY - grip.v;
    if (!grip.far && Math.hypot(du, dv) < 4) { return; }
    grip = { u: event.offsetX, v: event.offsetY, far: true };
    moved = true; view.x += du; view.y += dv; redraw();
  });
  canvas.addEventListener("pointerup", (event) => {
    if (grip && !grip.far) { pick(event.offsetX, event.offsetY); }
    grip = null;
  });
  canvas.addEventListener("pointercancel", () => { grip = null; });
  const steps = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] };
  canvas.addEventListener("keydown", (event) => {
    const middle = [canvas.clientWidth / 2, canvas.clientHeight / 2];
    if (steps[event.key]) {
      moved = true; view.x += steps[event.key][0]; view.y += steps[event.key][1]; redraw();
    } else if (event.key === "+" || event.key === "=") { moved = true; zoom(1.25, ...middle);
    } else if (event.key === "-") { moved = true; zoom(0.8, ...middle);
    } else if (event.key === "0") { moved = false; fit();
    } else if (event.key === "Escape") { select(null);
    } else { return; }
    event.preventDefault();
  });
  at("zoom-in").addEventListener("click", () => { moved = true; zoom(1.25, canvas.clientWidth / 2, canvas.clientHeight / 2); });
  at("zoom-out").addEventListener("click", () => { moved = true; zoom(0.8, canvas.clientWidth / 2, canvas.clientHeight / 2); });
  at("fit").addEventListener("click", () => { moved = false; fit(); });
  for (const box of ["show-trails", "show-ellipses", "show-names", "show-truth"]) { at(box).addEventListener("change", redraw); }
  at("site-select").addEventListener("change", (event) => { open(event.target.value).catch(() => later(begin)); });
  at("token-form").addEventListener("submit", (event) => {
    event.preventDefault();
    sessionStorage.setItem(TOKEN_KEY, at("token").value.trim());
    at("token").value = "";
    begin();
  });
  window.addEventListener("resize", resize);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    readColours();
    redraw();
    updateErrors();
  });
  document.addEventListener("visibilitychange", redraw);
}

function pick(u, v) {
  let nearest = null, least = 20;
  for (const device of devices.values()) {
    if (!isShown(device)) { continue; }
    const [du, dv] = toScreen(device.now.x_m, device.now.y_m);
    const away = Math.hypot(du - u, dv - v);
    if (away < least) { least = away; nearest = device.name; }
  }
  select(nearest);
}

// Tests and curious people read where things are drawn from here.
window.fplocMap = {
  place: (name) => { const device = devices.get(name); return device && isShown(device) ? toScreen(device.now.x_m, device.now.y_m) : null; },
  toScreen, devices: () => [...devices.keys()], drop: () => socket?.close(),
};

readColours();
listen();
setInterval(updateList, 500);
setInterval(updateReadings, 1000);
setInterval(() => {
  if (lastTickAt > 0 && performance.now() - lastTickAt > LOST_AFTER_MS && at("connection").dataset.state !== "lost") {
    state("lost", "no news from the server");
    socket?.close();
  }
}, 1000);
resize();
begin();
