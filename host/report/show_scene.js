"use strict";
// The path in 3D on a canvas: an orthographic view of north, east, up. It needs no graphics processor.

const SCENE = { canvas: null, still: null, azimuth: 0.6, elevation: 0.5, zoom: 1, centre: [0, 0, 0], width: 0, height: 0, shade: null };
const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const PIECES = 1500;

function pointsOf(track, name) {
  const channel = track.channels[name];
  if (!channel) return [];
  const step = Math.max(1, Math.ceil(channel.length / PIECES));
  const out = [];
  for (let i = 0; i < channel.length; i += step) {
    const row = channel.values.subarray(3 * i, 3 * i + 3);
    out.push(row.some(Number.isNaN) ? null : [row[0], row[1], row[2], i]);
  }
  return out;
}

function addScene(canvas) {
  SCENE.canvas = canvas;
  SCENE.still = document.createElement("canvas");
  for (const track of ALL_TRACKS) {
    track.path = pointsOf(track, "p");
    track.refPath = pointsOf(track, "p_ref");
  }
  turnable(canvas);
  new ResizeObserver(() => {
    if (canvas.clientWidth !== SCENE.width || canvas.clientHeight !== SCENE.height) drawStill();
  }).observe(canvas);
}

// Waypoints, gates and keep-out shapes of the routes that are shown.
function shownOf(kind) {
  const routes = new Set(TRACKS.map((track) => track.reference_id));
  return DATA.scene[kind].filter((one) => one.references.some((reference) => routes.has(reference)));
}

// Finds the room that the shown paths and routes need. Returns whether there is anything to draw.
function fitScene() {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  const include = (point, margin = 0) => {
    for (let k = 0; k < 3; k++) {
      low[k] = Math.min(low[k], point[k] - margin);
      high[k] = Math.max(high[k], point[k] + margin);
    }
  };
  for (const track of TRACKS) {
    for (const point of [...track.path, ...track.refPath]) if (point) include(point);
  }
  for (const point of shownOf("waypoints")) include(point.p);
  for (const shape of shownOf("keep_out")) {
    if (shape.kind === "box") { include(shape.low); include(shape.high); }
    else if (shape.kind === "sphere") include(shape.centre, shape.radius);
    else for (const up of [shape.low, shape.high]) {
      include([shape.centre[0] - shape.radius, shape.centre[1] - shape.radius, up]);
      include([shape.centre[0] + shape.radius, shape.centre[1] + shape.radius, up]);
    }
  }
  SCENE.low = null;
  if (!Number.isFinite(low[0])) return false;
  low[2] = Math.min(low[2], 0);
  SCENE.floor = low[2];
  SCENE.grid = spacing(2 * Math.max(0.5, 0.5 * Math.hypot(...low.map((value, k) => high[k] - value))));
  for (const k of [0, 1]) { // whole cells of the grid
    low[k] = Math.floor(low[k] / SCENE.grid) * SCENE.grid;
    high[k] = Math.ceil(high[k] / SCENE.grid) * SCENE.grid;
  }
  SCENE.centre = low.map((value, k) => 0.5 * (value + high[k]));
  SCENE.low = low;
  SCENE.high = high;
  return true;
}

// The distance of grid lines: about eight over the span.
function spacing(span) {
  const power = 10 ** Math.floor(Math.log10(span / 8));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= span / 8);
}

function turnable(canvas) {
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    if (pointers.size === 2) {
      const [other] = [...pointers.values()].filter((one) => one.pointerId !== event.pointerId);
      const span = (one) => Math.max(20, Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY));
      SCENE.zoom *= span(event) / span(before);
    } else {
      turn(0.008 * (before.clientX - event.clientX), 0.008 * (event.clientY - before.clientY));
    }
    pointers.set(event.pointerId, event);
    drawStill();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    SCENE.zoom *= Math.exp(-0.001 * event.deltaY);
    drawStill();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (moves[event.key]) turn(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") SCENE.zoom *= 1.15;
    else if (event.key === "-") SCENE.zoom /= 1.15;
    else return;
    event.preventDefault();
    drawStill();
  });
}

function turn(azimuth, elevation) {
  SCENE.azimuth += azimuth;
  SCENE.elevation = Math.max(-0.2, Math.min(Math.PI / 2, SCENE.elevation + elevation));
}

function lookFrom(azimuth, elevation) {
  Object.assign(SCENE, { azimuth, elevation, zoom: 1 });
  drawStill();
}

// The function from north, east, up to CSS pixels of the canvas.
function projection() {
  const { width, height, azimuth, elevation, centre } = SCENE;
  const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
  const flat = (n, e, u) => [-sa * n + ca * e, -(se * (ca * n + sa * e) + ce * u)];
  let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
  for (const n of [SCENE.low[0], SCENE.high[0]]) for (const e of [SCENE.low[1], SCENE.high[1]]) for (const u of [SCENE.low[2], SCENE.high[2]]) {
    const [x, y] = flat(n, e, u);
    x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
  }
  const room = 0.84 * Math.min(width / Math.max(x1 - x0, 0.5), height / Math.max(y1 - y0, 0.5));
  const scale = SCENE.zoom * room;
  SCENE.scale = scale;
  return ([n, e, u]) => {
    const [x, y] = flat(n - centre[0], e - centre[1], u - centre[2]);
    return [0.5 * width + scale * x, 0.5 * height + scale * y];
  };
}

function sized(canvas) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(SCENE.width * ratio);
  canvas.height = Math.round(SCENE.height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.lineJoin = context.lineCap = "round";
  context.font = "12px system-ui, sans-serif";
  return context;
}

// Draws what does not move with time, and then the vehicles.
function drawStill() {
  SCENE.width = SCENE.canvas.clientWidth;
  SCENE.height = SCENE.canvas.clientHeight;
  const context = sized(SCENE.still);
  const at = projection();
  const shading = shadingOf(SCENE.shade);
  drawGround(context, at);
  shownOf("keep_out").forEach((shape) => drawShape(context, at, shape, theme().forbidden, 0.1));
  for (const track of TRACKS) {
    context.setLineDash(track.what === "plan" ? [] : [4, 4]);
    if (track.drawsReference) stroke(context, at, track.refPath, SEVERAL && !track.sharesReference ? shown(track.colour) : theme().soft, track.what === "plan" ? 2 : 1.2);
    context.setLineDash([]);
    if (!shading) stroke(context, at, track.path, shown(track.colour), 2);
    else strokeShaded(context, at, track, shading);
  }
  if (shading) drawScale(context, shading);
  shownOf("gates").forEach((gate) => drawGate(context, at, gate));
  drawWaypoints(context, at);
  sized(SCENE.canvas);
  drawMoving(SCENE.sample || 0);
}

// Waypoints with their numbers; those close to each other share a label.
function drawWaypoints(context, at) {
  const groups = [];
  const waypoints = shownOf("waypoints");
  for (const point of waypoints) {
    const [x, y] = at(point.p);
    const near = groups.find((group) => Math.hypot(group.x - x, group.y - y) < 12);
    if (near) near.labels.push(point.label);
    else groups.push({ x, y, labels: [point.label] });
    context.beginPath();
    context.arc(x, y, 3.5, 0, 2 * Math.PI);
    context.fillStyle = theme().paper;
    context.strokeStyle = theme().ink;
    context.lineWidth = 1.2;
    context.fill();
    context.stroke();
  }
  if (waypoints.length > 40) return;
  context.fillStyle = theme().ink;
  for (const { x, y, labels } of groups) context.fillText(labels.length > 3 ? `${labels[0]}, ${labels[1]}, …` : labels.join(", "), x + 6, y - 5);
}

function line(context, points) {
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
}

function stroke(context, at, points, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.beginPath();
  let down = false;
  for (const point of points) {
    if (!point) { down = false; continue; }
    const [x, y] = at(point);
    if (down) context.lineTo(x, y);
    else context.moveTo(x, y);
    down = true;
  }
  context.stroke();
}

// A colour for a share of the greatest error; the greatest stands out most.
function colourOf(share) {
  const place = 4 * (theme().dark ? 0.25 + 0.75 * share : 0.8 * (1 - share));
  const k = Math.min(3, Math.floor(place));
  const mixed = VIRIDIS[k].map((value, i) => Math.round(value + (place - k) * (VIRIDIS[k + 1][i] - value)));
  return `rgb(${mixed.join(",")})`;
}

const SHADES = [
  { key: "error", column: 0, title: "tracking error", unit: "mm" },
  { key: "prediction", column: 0, title: "prediction error before", unit: "mm" },
  { key: "prediction", column: 1, title: "prediction error after", unit: "mm" },
  { key: "residual", column: 0, title: "predicted residual", unit: "m/s²" },
  { key: "speed", column: 0, title: "speed", unit: "m/s" },
];

// The quantities by which the shown paths can be coloured.
function shadesOf(tracks) {
  return SHADES.filter((shade) => tracks.some((track) => track.channels[shade.key]));
}

// A quantity with its greatest value on the shown paths, one scale for all; before and after share theirs.
function shadingOf(shade) {
  if (!shade) return null;
  let top = 0;
  for (const track of TRACKS) for (const value of track.channels[shade.key]?.values || []) if (value > top) top = value;
  return { ...shade, top: top || 1 };
}

function strokeShaded(context, at, track, shading) {
  const channel = track.channels[shading.key];
  let before = null;
  for (const point of track.what === "plan" ? track.refPath : track.path) {
    const here = point && at(point);
    if (here && before) {
      const value = channel ? channel.values[point[3] * channel.width + shading.column] : NaN;
      context.strokeStyle = Number.isNaN(value) ? theme().line : colourOf(value / shading.top);
      context.lineWidth = Number.isNaN(value) ? 1.2 : 3;
      line(context, [before, here]);
      context.stroke();
    }
    before = here;
  }
}

function drawScale(context, shading) {
  const width = 90, x = SCENE.width - width - 10, y = 12;
  for (let i = 0; i < width; i++) {
    context.fillStyle = colourOf(i / width);
    context.fillRect(x + i, y, 1.5, 8);
  }
  context.fillStyle = theme().soft;
  context.textAlign = "right";
  context.fillText(`${shading.title} 0 to ${shading.top.toFixed(shading.top < 10 ? 1 : 0)} ${shading.unit}`, x + width, y + 22);
  context.textAlign = "left";
}

function drawGround(context, at) {
  const step = SCENE.grid, u = SCENE.floor;
  const [n0, n1, e0, e1] = [SCENE.low[0], SCENE.high[0], SCENE.low[1], SCENE.high[1]];
  context.strokeStyle = theme().line;
  context.lineWidth = 1;
  for (let n = n0; n <= n1 + 1e-9; n += step) { line(context, [at([n, e0, u]), at([n, e1, u])]); context.stroke(); }
  for (let e = e0; e <= e1 + 1e-9; e += step) { line(context, [at([n0, e, u]), at([n1, e, u])]); context.stroke(); }
  context.fillStyle = theme().soft;
  const corner = [n0, e0, u];
  for (const [label, end] of [["N", [n1, e0, u]], ["E", [n0, e1, u]], ["up", [n0, e0, u + step]]]) {
    context.strokeStyle = theme().soft;
    context.lineWidth = 1.5;
    line(context, [at(corner), at(end)]);
    context.stroke();
    const [x, y] = at(end);
    context.fillText(label, x + 4, y - 4);
  }
  context.fillText(`grid ${Number(step.toPrecision(2))} m`, 10, SCENE.height - 10);
}

function circle(centre, radius, up) {
  return Array.from({ length: 33 }, (_, k) => {
    const angle = (k * Math.PI) / 16;
    return [centre[0] + radius * Math.cos(angle), centre[1] + radius * Math.sin(angle), up];
  });
}

function facesOf(shape) {
  if (shape.kind === "cylinder") {
    const low = circle(shape.centre, shape.radius, shape.low), high = circle(shape.centre, shape.radius, shape.high);
    return [low, high, ...low.slice(0, 32).map((point, k) => [point, low[k + 1], high[k + 1], high[k]])];
  }
  const { low, high } = shape;
  const corner = (bits) => [0, 1, 2].map((k) => ((bits >> k) & 1 ? high[k] : low[k]));
  return [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]].map((face) => face.map(corner));
}

function drawShape(context, at, shape, colour, alpha) {
  context.fillStyle = context.strokeStyle = colour;
  context.lineWidth = 1;
  if (shape.kind === "sphere") {
    const [x, y] = at(shape.centre);
    context.beginPath();
    context.arc(x, y, shape.radius * SCENE.scale, 0, 2 * Math.PI);
    context.stroke();
    context.globalAlpha = 2 * alpha;
    context.fill();
    context.globalAlpha = 1;
    return;
  }
  facesOf(shape).forEach((face, number) => {
    line(context, face.map(at));
    context.closePath();
    context.globalAlpha = shape.kind === "cylinder" && number > 1 ? 0.25 * alpha : alpha;
    context.fill();
    context.globalAlpha = shape.kind === "cylinder" && number > 1 ? 0.15 : 0.8;
    context.stroke();
  });
  context.globalAlpha = 1;
}

function drawGate(context, at, gate) {
  context.strokeStyle = theme().ink;
  context.lineWidth = 2;
  if (gate.kind === "sphere") {
    const [x, y] = at(gate.centre);
    context.beginPath();
    context.arc(x, y, gate.radius * SCENE.scale, 0, 2 * Math.PI);
  } else {
    line(context, gate.corners.map(at));
    context.closePath();
  }
  context.stroke();
}

// Draws vehicles, their references and error arrows at a sample. Returns where the first vehicle is, CSS pixels.
function drawMoving(sample) {
  SCENE.sample = sample;
  const context = SCENE.canvas.getContext("2d");
  const at = projection();
  context.clearRect(0, 0, SCENE.width, SCENE.height);
  context.drawImage(SCENE.still, 0, 0, SCENE.width, SCENE.height);
  let first = null;
  for (const track of TRACKS) {
    const p = rowAt(track, "p", sample) || (track.what === "plan" ? rowAt(track, "p_ref", sample) : null);
    const ref = rowAt(track, "p_ref", sample);
    if (!p) continue;
    const colour = SEVERAL ? shown(track.colour) : theme().ink;
    if (ref && track.what !== "plan") drawError(context, at(ref), at(p));
    drawVehicle(context, at, p, rowAt(track, "q", sample), track, colour);
    first = first || at(p);
  }
  return first;
}

function drawError(context, from, to) {
  context.strokeStyle = context.fillStyle = shown("#d55e00");
  context.lineWidth = 2;
  line(context, [from, to]);
  context.stroke();
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
  context.beginPath();
  context.arc(from[0], from[1], 3, 0, 2 * Math.PI);
  context.stroke();
  if (length < 4) return;
  const ux = (to[0] - from[0]) / length, uy = (to[1] - from[1]) / length, size = Math.min(7, 0.6 * length);
  line(context, [to, [to[0] - size * (ux + 0.5 * uy), to[1] - size * (uy - 0.5 * ux)], [to[0] - size * (ux - 0.5 * uy), to[1] - size * (uy + 0.5 * ux)]]);
  context.closePath();
  context.fill();
}

function drawVehicle(context, at, p, q, track, colour) {
  const rotors = track.vehicle.rotors_frd_m;
  if (!q || !rotors) {
    const [x, y] = at(p);
    context.fillStyle = colour;
    context.beginPath();
    context.arc(x, y, 5, 0, 2 * Math.PI);
    context.fill();
    return;
  }
  const [w, x, y, z] = q;
  const arm = Math.max(...rotors.map((rotor) => Math.hypot(...rotor)));
  const grown = Math.max(1, 16 / (arm * SCENE.scale));
  SCENE.grown = grown;
  const world = ([f, r, d]) => {
    const n = (1 - 2 * (y * y + z * z)) * f + 2 * (x * y - w * z) * r + 2 * (x * z + w * y) * d;
    const e = 2 * (x * y + w * z) * f + (1 - 2 * (x * x + z * z)) * r + 2 * (y * z - w * x) * d;
    const down = 2 * (x * z - w * y) * f + 2 * (y * z + w * x) * r + (1 - 2 * (x * x + y * y)) * d;
    return at([p[0] + grown * n, p[1] + grown * e, p[2] - grown * down]);
  };
  const centre = at(p);
  context.strokeStyle = context.fillStyle = colour;
  for (const rotor of rotors) {
    context.lineWidth = 2;
    line(context, [centre, world(rotor)]);
    context.stroke();
    line(context, Array.from({ length: 17 }, (_, k) => {
      const angle = (k * Math.PI) / 8;
      return world([rotor[0] + 0.45 * arm * Math.cos(angle), rotor[1] + 0.45 * arm * Math.sin(angle), rotor[2]]);
    }));
    context.lineWidth = 1.5;
    context.stroke();
  }
  context.strokeStyle = shown("#009e73");
  context.lineWidth = 3;
  line(context, [centre, world([1.5 * arm, 0, 0])]);
  context.stroke();
}
