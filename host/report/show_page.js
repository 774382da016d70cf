"use strict";
// The slider, the events, and the check of the page itself (address with #check).

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

function redraw() {
  PLOTS.forEach(draw);
  if (SCENE.low) drawStill();
  showTime();
}

function start() {
  if (!TRACKS.length) return;
  slider.max = String(TIMES_S.length - 1);
  slider.value = String(sampleAt(0));
  addPlots(document.getElementById("plots"));
  const canvas = document.getElementById("scene");
  if (addScene(canvas)) lookFrom(0.6, 0.5);
  else document.getElementById("view").hidden = true;
  const events = document.getElementById("events");
  if (events) addEvents(events);
  ready = true;
  showTime();
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
function check() {
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
  return {
    plots: PLOTS.map((plot) => ({ title: plot.title, series: plot.series.length, colours: inked(plot.chart.ctx.canvas) })),
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
  window.addEventListener("load", () => {
    const result = {
      drawn_ms,
      since_opened_ms: performance.now(),
      ...(TRACKS.length ? check() : {}),
      width: window.innerWidth,
      overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
      requests: performance.getEntriesByType("resource").length,
      errors: window.pageErrors,
    };
    const output = document.createElement("pre");
    output.id = "check";
    output.textContent = JSON.stringify(result);
    document.body.append(output);
  });
}
