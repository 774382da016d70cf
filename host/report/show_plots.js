"use strict";
// Plots over time, with one cursor for all and one range of time.

const QUANTITIES = [
  { key: "prediction", title: "Prediction error", unit: "mm", names: ["before", "after", "noise floor"], dashes: [[6, 3], [], [2, 4]], colours: [1, 0, 6], byTrack: true },
  { key: "error", title: "Tracking error", unit: "mm", names: ["distance from the reference"] },
  { key: "p", ref: "p_ref", title: "Position", unit: "m", names: ["north", "east", "up"], refName: "reference" },
  { key: "v", ref: "v_ref", title: "Velocity", unit: "m/s", names: ["north", "east", "up"], refName: "reference" },
  { key: "speed", title: "Planned speed", unit: "m/s", names: ["speed"] },
  { key: "residual", title: "Predicted residual", unit: "m/s²", names: ["residual"] },
  { key: "margin", title: "Margin to the limits", unit: "1", names: ["speed", "tilt", "body rate", "jerk", "thrust"] },
  { key: "thrust", title: "Rotor thrust", unit: "of maximum", names: ["rotor 1", "rotor 2", "rotor 3", "rotor 4"] },
  { key: "attitude", ref: "yaw_ref", refColumn: 2, title: "Attitude", unit: "deg", names: ["roll", "pitch", "yaw"], refName: "reference" },
  { key: "rate", ref: "rate_ref", title: "Body rate", unit: "rad/s", names: ["forward", "right", "down"], refName: "commanded" },
  { key: "motor", title: "Motor commands", unit: "0 to 1", names: ["motor 1", "motor 2", "motor 3", "motor 4"] },
];

const FROM_ZERO = ["prediction", "error", "speed", "residual"];
const PLOTS = [];
let scaling = false;

function seriesOf(quantity, columns) {
  const series = [];
  for (const track of TRACKS) {
    for (const column of columns) {
      const colour = SEVERAL ? track.colour : OKABE_ITO[column % OKABE_ITO.length];
      const name = (SEVERAL ? track.name : quantity.names[column]);
      const refColumn = quantity.refColumn === undefined ? column : column - quantity.refColumn;
      const ref = track.channels[quantity.ref];
      const wanted = quantity.refName === "commanded" ? !SEVERAL : track.drawsReference;
      if (ref && wanted && refColumn >= 0 && refColumn < ref.width) {
        const planned = track.what === "plan" && !track.channels[quantity.key];
        const shared = REFERENCES.size > 1 ? `${quantity.refName} of ${track.name}` : quantity.refName;
        const named = track.sharesReference ? shared : `${name}, ${quantity.refName}`;
        const label = planned ? `${name}, planned` : named;
        const own = track.sharesReference && !planned ? OKABE_ITO[6] : colour;
        series.push({ label, colour: own, dash: planned ? track.dash : [4, 4], y: columnOf(track, quantity.ref, refColumn) });
      }
      const channel = track.channels[quantity.key];
      if (channel && column < channel.width) {
        series.push({ label: name, colour, dash: SEVERAL ? track.dash : [], y: columnOf(track, quantity.key, column) });
      }
    }
  }
  return series.filter((one) => one.y.some((value) => value !== null));
}

// The lines of one track in a plot of its own.
function seriesOfTrack(quantity, track) {
  const channel = track.channels[quantity.key];
  if (!channel) return [];
  return quantity.names.slice(0, channel.width).map((label, column) => ({
    label,
    colour: OKABE_ITO[quantity.colours[column]],
    dash: quantity.dashes[column],
    y: columnOf(track, quantity.key, column),
  })).filter((one) => one.y.some((value) => value !== null));
}

function addPlots(parent) {
  PLOTS.forEach((plot) => plot.chart.destroy());
  PLOTS.length = 0;
  parent.replaceChildren();
  for (const quantity of QUANTITIES) {
    if (quantity.byTrack) {
      for (const track of TRACKS) {
        const series = seriesOfTrack(quantity, track);
        if (series.length) addPlot(parent, quantity, SEVERAL ? `${quantity.title}: ${track.name}` : quantity.title, series);
      }
      continue;
    }
    const all = quantity.names.map((_, column) => column);
    for (const columns of SEVERAL ? all.map((column) => [column]) : [all]) {
      const series = seriesOf(quantity, columns);
      if (!series.length) continue;
      const several = SEVERAL && quantity.names.length > 1;
      addPlot(parent, quantity, several ? `${quantity.title}: ${quantity.names[columns[0]]}` : quantity.title, series);
    }
  }
}

function addPlot(parent, quantity, title, series) {
  const figure = document.createElement("figure");
  figure.className = "plot";
  const heading = document.createElement("h3");
  heading.textContent = `${title}, ${quantity.unit === "1" ? "share (0: at the limit)" : quantity.unit}`;
  const holder = document.createElement("div");
  const legend = document.createElement("figcaption");
  figure.append(heading, holder, legend);
  parent.append(figure);
  const values = series.map((one) => {
    const entry = document.createElement("span");
    const swatch = document.createElement("i");
    const value = document.createElement("b");
    swatch.style.borderTopStyle = one.dash.length ? "dashed" : "solid";
    entry.append(swatch, ` ${one.label} `, value);
    legend.append(entry);
    return { swatch, value };
  });
  const plot = { quantity, title, series, holder, values, figure, chart: null, line: null };
  PLOTS.push(plot);
  draw(plot);
}

function axisOf(label, size) {
  const colours = theme();
  return {
    label,
    labelSize: 16,
    size,
    stroke: colours.soft,
    font: "12px system-ui, sans-serif",
    labelFont: "12px system-ui, sans-serif",
    grid: { stroke: colours.line, width: 1 },
    ticks: { stroke: colours.line, width: 1, size: 4 },
  };
}

function draw(plot) {
  const range = plot.chart ? [plot.chart.scales.x.min, plot.chart.scales.x.max] : null;
  if (plot.chart) plot.chart.destroy();
  const fromZero = FROM_ZERO.includes(plot.quantity.key);
  const options = {
    width: Math.max(200, plot.holder.clientWidth),
    height: 170,
    padding: [8, 8, 0, 0],
    scales: { x: { time: false }, y: fromZero ? { range: (_, low, high) => [0, 1.06 * high || 1] } : {} },
    legend: { show: false },
    cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false } },
    axes: [axisOf(`time from ${zeroWords()}, s`, 30), axisOf(plot.quantity.unit === "1" ? "share" : plot.quantity.unit, 46)],
    series: [{}, ...plot.series.map((one) => ({
      label: one.label,
      stroke: shown(one.colour),
      width: one.dash.length ? 1 : 1.5,
      dash: one.dash,
      points: { show: false },
    }))],
    hooks: { setScale: [(chart, key) => key === "x" && follow(chart)], drawClear: [drawEvents] },
  };
  plot.chart = new uPlot(options, [TIMES_S, ...plot.series.map((one) => one.y)], plot.holder);
  if (range && range[0] !== null) plot.chart.setScale("x", { min: range[0], max: range[1] });
  plot.series.forEach((one, k) => { plot.values[k].swatch.style.borderTopColor = shown(one.colour); });
  plot.line = document.createElement("div");
  plot.line.className = "cursor";
  plot.chart.over.append(plot.line);
  plot.chart.over.addEventListener("pointermove", (event) => {
    if (event.buttons && event.pointerType === "mouse") return; // a range is being chosen
    setTime(plot.chart.posToVal(event.offsetX, "x"));
  });
}

function zeroWords() {
  return [...new Set(TRACKS.map((track) => track.zero))].join(" or ");
}

// All plots show the same range of time.
function follow(chart) {
  if (scaling) return;
  scaling = true;
  const { min, max } = chart.scales.x;
  for (const plot of PLOTS) if (plot.chart && plot.chart !== chart) plot.chart.setScale("x", { min, max });
  scaling = false;
  if (ready) showTime();
}

function drawEvents(chart) {
  const context = chart.ctx;
  context.save();
  context.lineWidth = 1;
  for (const track of TRACKS) {
    for (const event of track.events) {
      if (event.kind === "text") continue;
      const x = Math.round(chart.valToPos(event.t_s, "x", true)) + 0.5;
      if (x < chart.bbox.left || x > chart.bbox.left + chart.bbox.width) continue;
      context.strokeStyle = event.kind === "failsafe" ? theme().forbidden : SEVERAL ? shown(track.colour) : theme().soft;
      context.setLineDash(event.kind === "failsafe" ? [] : [2, 4]);
      context.beginPath();
      context.moveTo(x, chart.bbox.top);
      context.lineTo(x, chart.bbox.top + chart.bbox.height);
      context.stroke();
    }
  }
  context.restore();
}

function digits(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 1 : size >= 10 ? 2 : 3);
}

// Moves the cursor of every plot to a sample, and writes the values there.
function showCursors(sample, t_s) {
  for (const plot of PLOTS) {
    const left = plot.chart.valToPos(t_s, "x");
    const width = plot.chart.bbox.width / uPlot.pxRatio;
    plot.line.style.transform = `translateX(${left}px)`;
    plot.line.hidden = left < 0 || left > width;
    plot.series.forEach((one, k) => { plot.values[k].value.textContent = digits(one.y[sample]); });
  }
}
