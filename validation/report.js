// Sheets in 3D: drawn when they scroll into view and removed when they leave (a browser allows about
// sixteen WebGL contexts). The viewpoint is kept.
"use strict";
const round = x => x.toFixed(1).replace(/^-0\.0$/, "0.0");
const config = {displaylogo: false, responsive: true, showSendToCloud: false};

function draw(box) {
  if (box.dataset.drawn) return;
  box.dataset.drawn = "yes";
  if (!box.figure) box.figure = JSON.parse(document.getElementById(box.dataset.figure).textContent);
  const probe = box.parentElement.querySelector(".probe");
  Plotly.newPlot(box, box.figure.data, box.figure.layout, config).then(() => {
    const show = event => {
      const point = event.points[0];
      if (!point || !point.customdata) return;
      const [gamma, X, Y, E11, E22] = point.customdata;
      probe.textContent = `γ = ${round(gamma)}° at X = ${round(X)}, Y = ${round(Y)} mm`
        + ` on the flat blank; E11 = ${E11.toExponential(1)}, E22 = ${E22.toExponential(1)}`;
    };
    box.on("plotly_hover", show);
    box.on("plotly_click", show);
  }).catch(() => box.closest("figure").classList.add("flat"));
}

function remove(box) {
  if (!box.dataset.drawn) return;
  if (box.layout && box.layout.scene.camera) box.figure.layout.scene.camera = box.layout.scene.camera;
  Plotly.purge(box);
  delete box.dataset.drawn;
}

const watcher = new IntersectionObserver(
  entries => entries.forEach(e => (e.isIntersecting ? draw : remove)(e.target)),
  {rootMargin: "300px"},
);
document.querySelectorAll(".sheet").forEach(box => watcher.observe(box));
