"use strict";
// Unpacks plotly.js, draws the figures, the first ones first, and moves all time axes together.
const { figures, arrays } = JSON.parse(document.getElementById("figures").textContent);
restore(figures);
const places = [...document.querySelectorAll(".figure")];
const common = {
  margin: { l: 76, r: 24, t: 30, b: 42 },
  paper_bgcolor: "rgba(0,0,0,0)",
  plot_bgcolor: "rgba(0,0,0,0)",
  font: { family: "system-ui, sans-serif", size: 12.5, color: "#1c2430" },
  legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yanchor: "bottom",
    traceorder: "normal" },
  modebar: { bgcolor: "rgba(0,0,0,0)", color: "#9aa5b1", activecolor: "#0072b2" },
};
const axis = { gridcolor: "#e6ebf1", linecolor: "#9aa5b1", showline: true, ticks: "outside" };
const options = { responsive: true, displaylogo: false, scrollZoom: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "sendDataToCloud", "zoomIn2d", "zoomOut2d"] };
const PAPER = 680; // px, within the margins of A4 and Letter
let range = null; // of all time axes; null is that of each figure
let moving = false;

// Puts the arrays, which many traces share, into their places.
function restore(value) {
  if (value === null || typeof value !== "object") return;
  if (typeof value.bdata === "number") value.bdata = arrays[value.bdata];
  Object.values(value).forEach(restore);
}

// Base64 of gzip: Chromium 80, Firefox 113, Safari 16.4 and later.
async function unpack() {
  const packed = document.getElementById("plotly").textContent;
  const bytes = (await fetch(`data:application/gzip;base64,${packed}`)).body;
  const stream = bytes.pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);
}

async function draw(place) {
  const { data, layout, time } = figures[place.dataset.figure];
  const full = { ...common, ...layout,
    xaxis: { ...axis, ...layout.xaxis }, yaxis: { ...axis, ...layout.yaxis } };
  if (time && range) full.xaxis.range = [...range];
  await Plotly.newPlot(place, data, full, options);
  place.dataset.drawn = "yes";
  if (time) place.on("plotly_relayout", (change) => follow(place, change));
}

function follow(moved, change) {
  if (moving) return;
  if ("xaxis.range[0]" in change) {
    range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
  } else if (change["xaxis.autorange"]) {
    range = null;
  } else {
    return;
  }
  moving = true;
  const others = places.filter((place) =>
    place !== moved && place.dataset.drawn && figures[place.dataset.figure].time);
  const home = (place) => figures[place.dataset.figure].layout.xaxis.range;
  const move = (place) => Plotly.relayout(place, { "xaxis.range": [...(range || home(place))] });
  Promise.all(others.map(move))
    .finally(() => { moving = false; });
}

// On paper figures are as wide as its text and not as the window was.
function fit(layout) {
  for (const place of places) if (place.dataset.drawn) Plotly.relayout(place, layout);
}
addEventListener("beforeprint", () => fit({ width: PAPER, autosize: false }));
addEventListener("afterprint", () => fit({ width: null, autosize: true }));

// One figure at a time, so that the page can be read and moved meanwhile.
async function drawAll() {
  try {
    await unpack();
  } catch (error) {
    document.getElementById("undrawn").hidden = false;
    throw error;
  }
  for (const place of places) {
    await draw(place);
    await new Promise((go) => setTimeout(go));
  }
  document.body.dataset.drawn = "all";
}

drawAll();
