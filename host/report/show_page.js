"use strict";
// The slider, the choice of flights, the events, and the check of the page itself (address with #check).

const slider = document.getElementById("slider");
let ready = false;
let playing = 0;
let now_s = 0;

function setTime(t_s) {
  slider.value = String(sampleAt(t_s));
  showTime();
}

function showTime() {
  const sample = Number(slider.value);
  now_s = TIMES_S[sample];
  showCursors(sample, now_s);
  if (SCENE.low) SCENE.vehicleAt = drawMoving(sample);
  document.getElementById("time").textContent = `${now_s.toFixed(2)} s`;
  slider.setAttribute("aria-valuetext", `${now_s.toFixed(2)} s from ${zeroWords()}`);
  document.getElementById("phase").textContent = TRACKS.map(phaseOf).filter(Boolean).join(" · ");
}

function phaseOf(track) {
  const phases = track.events.filter((event) => event.kind === "phase" && event.t_s <= now_s + 1e-9);
  if (!phases.length) return "";
  const phase = phases[phases.length - 1].text;
  return SEVERAL ? `${track.name}: ${phase}` : phase;
}

function addEvents(list) {
  list.replaceChildren();
  for (const track of TRACKS) {
    for (const event of track.events) {
      const entry = document.createElement("li");
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `${event.t_s.toFixed(2)} s`;
      button.addEventListener("click", () => setTime(event.t_s));
      const text = event.kind === "text" ? event.text : `${event.kind} ${event.text}`;
      entry.className = event.kind;
      entry.append(button, ` ${SEVERAL ? `${track.name}: ` : ""}${text}`);
      list.append(entry);
    }
  }
}

function play() {
  const button = document.getElementById("play");
  if (playing) {
    cancelAnimationFrame(playing);
    playing = 0;
    button.textContent = "Play";
    return;
  }
  if (Number(slider.value) >= TIMES_S.length - 1) setTime(TIMES_S[0]);
  const began = performance.now() - 1e3 * now_s;
  const step = (clock) => {
    setTime((clock - began) * 1e-3);
    if (Number(slider.value) < TIMES_S.length - 1) playing = requestAnimationFrame(step);
    else { playing = 0; button.textContent = "Play"; }
  };
  button.textContent = "Stop";
  playing = requestAnimationFrame(step);
}

// The lines beside the boxes are those of the plots; a flight that is not shown has none.
function colourChoice() {
  document.querySelectorAll("#choice i").forEach((swatch) => {
    const track = TRACKS.find((one) => one.number === Number(swatch.dataset.number));
    swatch.style.borderTop = track ? `3px ${track.dash.length ? "dashed" : "solid"} ${shown(track.colour)}` : "3px solid transparent";
  });
}

function redraw() {
  colourChoice();
  PLOTS.forEach(draw);
  if (SCENE.low) drawStill();
  showTime();
}

// Draws these tracks, at the same time as before as far as they last.
function drawTracks(tracks) {
  ready = false;
  if (playing) play();
  showTracks(tracks);
  slider.max = String(TIMES_S.length - 1);
  slider.value = String(sampleAt(now_s));
  offerShades();
  colourChoice();
  addPlots(document.getElementById("plots"));
  const view = document.getElementById("view");
  view.hidden = !fitScene();
  if (!view.hidden) drawStill();
  const events = document.getElementById("events");
  if (events) addEvents(events);
  ready = true;
  showTime();
}

// A box for each flight, under the name of its group. One flight at least is always shown.
function addChoice(parent) {
  if (ALL_TRACKS.length < 2) return;
  parent.hidden = false;
  const boxes = ALL_TRACKS.map((track) => {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: track.shown });
    box.addEventListener("change", () => {
      const tracks = ALL_TRACKS.filter((_, k) => boxes[k].checked);
      if (tracks.length) drawTracks(tracks);
      else box.checked = true;
    });
    return box;
  });
  for (const group of new Set(ALL_TRACKS.map((track) => track.group))) {
    const row = document.createElement("p");
    const members = ALL_TRACKS.filter((track) => track.group === group);
    const alone = Object.assign(document.createElement("button"), { type: "button", textContent: group || "all" });
    alone.title = "Show these only";
    alone.addEventListener("click", () => {
      ALL_TRACKS.forEach((track, k) => { boxes[k].checked = track.group === group; });
      drawTracks(members);
    });
    row.append(alone);
    for (const track of members) {
      const label = document.createElement("label");
      const swatch = document.createElement("i");
      swatch.dataset.number = track.number;
      label.append(boxes[track.number], " ", swatch, ` ${track.name}`);
      row.append(label);
    }
    parent.append(row);
  }
}

// What colours the paths: the flights' own colours if there are several, else the first quantity.
function offerShades() {
  const list = document.getElementById("shade");
  const before = list.value;
  const shades = shadesOf(TRACKS);
  const own = new Option(SEVERAL ? "flight" : "nothing", "");
  list.replaceChildren(own, ...shades.map((shade) => new Option(shade.title, shade.title)));
  const kept = [...list.options].some((option) => option.value === before) && list.dataset.chosen;
  list.value = kept ? before : SEVERAL || !shades.length ? "" : shades[0].title;
  SCENE.shade = shades.find((shade) => shade.title === list.value) || null;
}

function start() {
  if (!ALL_TRACKS.length) return;
  const canvas = document.getElementById("scene");
  addScene(canvas);
  Object.assign(SCENE, { azimuth: 0.6, elevation: 0.5 });
  addChoice(document.getElementById("choice"));
  drawTracks(ALL_TRACKS.filter((track) => track.shown));
  const shade = document.getElementById("shade");
  shade.addEventListener("change", () => {
    shade.dataset.chosen = "yes";
    offerShades();
    drawStill();
  });
  slider.addEventListener("input", showTime);
  document.getElementById("play").addEventListener("click", play);
  document.querySelectorAll("#view button").forEach((button) => {
    button.addEventListener("click", () => lookFrom(...button.dataset.look.split(" ").map(Number)));
  });
  let width = document.documentElement.clientWidth;
  window.addEventListener("resize", () => {
    if (width === document.documentElement.clientWidth) return;
    width = document.documentElement.clientWidth;
    redraw();
  });
  darkQuery.addEventListener("change", redraw);
  window.addEventListener("beforeprint", () => { printing = true; redraw(); });
  window.addEventListener("afterprint", () => { printing = false; redraw(); });
}

// What a test asks of the page: every plot drawn, what the slider moves and how long a step takes.
async function check() {
  const places = [];
  const steps = 50;
  const began = performance.now();
  for (let k = 0; k <= steps; k++) {
    slider.value = String(Math.round((k / steps) * (TIMES_S.length - 1)));
    slider.dispatchEvent(new Event("input"));
    places.push({ vehicle: SCENE.vehicleAt, cursors: PLOTS.map((plot) => plot.line.style.transform) });
  }
  const step_ms = (performance.now() - began) / (steps + 1);
  const inked = (canvas) => {
    const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    const colours = new Set();
    for (let i = 0; i < pixels.length; i += 4) if (pixels[i + 3]) colours.add((pixels[i] << 16) | (pixels[i + 1] << 8) | pixels[i + 2]);
    return colours.size;
  };
  const plots = PLOTS.map((plot) => ({ title: plot.title, series: plot.series.length, colours: inked(plot.chart.ctx.canvas) }));
  window.dispatchEvent(new Event("beforeprint"));
  await null; // plots are drawn when this script pauses
  const dark_in_print = theme().dark;
  PLOTS.forEach((plot, k) => { plots[k].colours_in_print = inked(plot.chart.ctx.canvas); });
  window.dispatchEvent(new Event("afterprint"));
  return {
    plots,
    dark_in_print,
    scene_colours: SCENE.low ? inked(SCENE.canvas) : 0,
    vehicle_places: new Set(places.map((place) => JSON.stringify(place.vehicle))).size,
    cursor_places: PLOTS.map((_, k) => new Set(places.map((place) => place.cursors[k])).size),
    step_ms,
  };
}

const drawing = performance.now();
start();
const drawn_ms = performance.now() - drawing;
if (location.hash === "#check") {
  window.addEventListener("load", async () => {
    const result = {
      drawn_ms,
      dark: theme().dark,
      since_opened_ms: performance.now(),
      ...(TRACKS.length ? { ...await check(), choices: document.querySelectorAll("#choice input").length } : {}),
      errors: window.pageErrors,
    };
    const output = document.createElement("pre");
    output.id = "check";
    output.textContent = JSON.stringify(result);
    document.body.append(output);
  });
}
