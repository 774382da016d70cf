"use strict";
// Data of the page: tracks decoded to arrays, one time axis for those that are shown, colours of the theme.

const DATA = JSON.parse(document.getElementById("show-data").textContent);
const OKABE_ITO = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999"];
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3]];

function decoded(channel) {
  const text = atob(channel.data);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const view = new DataView(bytes.buffer);
  const values = new Float32Array(bytes.length / 4);
  for (let i = 0; i < values.length; i++) values[i] = view.getFloat32(4 * i, true);
  return { width: channel.width, length: values.length / channel.width, values };
}

const ALL_TRACKS = DATA.tracks.map((track, number) => ({
  ...track,
  number,
  channels: Object.fromEntries(Object.entries(track.channels).map(([name, channel]) => [name, decoded(channel)])),
}));
const STEP_S = ALL_TRACKS.length ? ALL_TRACKS[0].step_s : 0.01;

// What is shown: tracks, their references, and the common time axis.
let TRACKS = [], REFERENCES = new Set(), SEVERAL = false, FIRST = 0, LAST = 0, TIMES_S = [];

function showTracks(tracks) {
  TRACKS = tracks;
  TRACKS.forEach((track, k) => {
    track.colour = OKABE_ITO[k % OKABE_ITO.length];
    track.dash = DASHES[Math.floor(k / OKABE_ITO.length) % DASHES.length];
  });
  // Flights of one reference share its lines; a plan of it draws them as its own.
  for (const track of TRACKS) {
    const same = TRACKS.filter((other) => track.reference_id !== null && other.reference_id === track.reference_id);
    track.drawsReference = !same.length || track === (same.find((other) => other.what === "plan") || same[0]);
    track.sharesReference = same.length > 1 && track.what !== "plan";
  }
  REFERENCES = new Set(TRACKS.filter((track) => track.channels.p_ref).map((track) => track.reference_id || track.number));
  SEVERAL = TRACKS.length > 1;
  FIRST = Math.min(...TRACKS.map((track) => track.first));
  LAST = Math.max(...TRACKS.map((track) => track.first + lengthOf(track) - 1));
  TIMES_S = Array.from({ length: LAST - FIRST + 1 }, (_, i) => (FIRST + i) * STEP_S);
}

function lengthOf(track) {
  return Math.max(1, ...Object.values(track.channels).map((channel) => channel.length));
}

// One column of a channel on the common time axis, null where there is no value. Yaw has no jumps of a turn.
function columnOf(track, name, column) {
  const channel = track.channels[name];
  const out = new Array(TIMES_S.length).fill(null);
  const start = track.first - FIRST;
  for (let i = 0; i < channel.length; i++) {
    const value = channel.values[i * channel.width + column];
    if (!Number.isNaN(value)) out[start + i] = value;
  }
  if (name === "attitude" && column === 2) return continuous(out, () => firstYaw());
  if (name !== "yaw_ref") return out;
  const yaw = track.channels.attitude ? columnOf(track, "attitude", 2) : [];
  return continuous(out, (i) => yaw[i] ?? firstYaw());
}

// Yaw without jumps of a turn. It starts within half a turn of `near` at that sample.
function continuous(yaw, near) {
  let before = null;
  return yaw.map((value, i) => {
    if (value === null) return null;
    const from = before === null ? near(i) ?? value : before;
    before = value + 360 * Math.round((from - value) / 360);
    return before;
  });
}

// The first yaw of the first track that has an attitude; null without any.
function firstYaw() {
  const attitude = TRACKS.find((track) => track.channels.attitude)?.channels.attitude;
  const yaw = attitude?.values.find((value, i) => i % 3 === 2 && !Number.isNaN(value));
  return yaw ?? null;
}

// The row of a channel at a sample of the common axis; null where it has none.
function rowAt(track, name, sample) {
  const channel = track.channels[name];
  const i = sample + FIRST - track.first;
  if (!channel || i < 0 || i >= channel.length) return null;
  const row = channel.values.subarray(i * channel.width, (i + 1) * channel.width);
  return row.some(Number.isNaN) ? null : row;
}

function sampleAt(t_s) {
  return Math.max(0, Math.min(TIMES_S.length - 1, Math.round(t_s / STEP_S) - FIRST));
}

let printing = false;
const darkQuery = window.matchMedia("(prefers-color-scheme: dark)");

function theme() {
  const dark = darkQuery.matches && !printing;
  return dark
    ? { dark, ink: "#e4e8ea", soft: "#9aa5ad", line: "#39424a", paper: "#171b1e", forbidden: "#ff8a66" }
    : { dark, ink: "#1c2329", soft: "#5d6770", line: "#d9dee2", paper: "#ffffff", forbidden: "#b5482f" };
}

// Blue is too dark on a dark page; the sky blue of the same palette is not.
function shown(colour) {
  if (!theme().dark) return colour;
  return { "#0072b2": "#56b4e9", "#56b4e9": "#2f8fd0", "#009e73": "#1fc796", "#d55e00": "#f07f2e" }[colour] || colour;
}
