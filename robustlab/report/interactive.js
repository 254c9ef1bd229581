// Each figure with curves gets a button: its panels then become charts to zoom and to read values from.
(() => {
  "use strict";
  const element = (tag, name, text) => {
    const made = document.createElement(tag);
    made.className = name;
    made.textContent = text;
    return made;
  };
  const number = (value) => (value == null ? "–" : String(Number(value.toPrecision(4))));

  function chart(panel, place) {
    const tables = panel.series.map((s) => [s.x, s.y]);
    const data = tables.length > 1 ? uPlot.join(tables, tables.map((t) => t.map(() => 1))) : tables[0];
    const scale = (side) => ({ time: false, distr: side.log ? 3 : 1, range: () => side.range });
    const axis = (side, size) => ({
      label: side.label, stroke: "#444", grid: { stroke: "#e3e5e8", width: 1 }, ticks: { stroke: "#999", width: 1 }, size, labelSize: 22,
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
    });
    const bands = [];
    const series = panel.series.map((s, k) => {
      if (s.band === 1) bands.push({ series: [k + 1, k], fill: s.colour + "40" });
      return {
        label: s.label || panel.y.label || "value", stroke: s.colour, width: s.width, dash: s.dash, spanGaps: false,
        value: (_, v) => number(v), points: { show: Boolean(s.points), size: 5, fill: s.colour },
        ...(s.bars ? { paths: uPlot.paths.bars({ size: [0.9, 100] }), fill: s.colour } : {}),
      };
    });
    const width = Math.max(280, place.clientWidth);
    place.append(element("p", "panel-title", panel.title));
    return new uPlot({
      width, height: Math.round(Math.min(380, Math.max(240, 0.42 * width))), bands,
      scales: { x: scale(panel.x), y: scale(panel.y) },
      axes: [axis(panel.x, 36), axis(panel.y, 60)],
      series: [{ label: panel.x.label || "x", value: (_, v) => number(v) }, ...series],
      cursor: { drag: { x: true, y: true, uni: 25 }, focus: { prox: 24 } },
      focus: { alpha: 0.35 },
      legend: { live: true },
    }, data, place);
  }

  function openable(figure) {
    const curves = JSON.parse(figure.dataset.curves);
    const button = element("button", "explore", "Zoom and read values");
    const picture = figure.querySelector("img");
    let place = null;
    button.type = "button";
    button.setAttribute("aria-expanded", "false");
    const turn = () => {
      const open = place === null || place.hidden;
      if (place === null) {
        place = element("div", "plots", "");
        picture.after(place);
        place.append(element("p", "hint", "Drag over a part to zoom, double-click to see all; the legend shows the values at the cursor, a click on it hides a curve."));
        for (const panel of curves.panels) chart(panel, place);
      }
      place.hidden = !open;
      picture.hidden = open && curves.whole;
      button.textContent = open ? "Back to the picture" : "Zoom and read values";
      button.setAttribute("aria-expanded", String(open));
    };
    button.addEventListener("click", turn);
    picture.addEventListener("dblclick", turn);
    figure.append(button);
  }

  document.querySelectorAll("figure[data-curves]").forEach(openable);
  const named = document.getElementById(location.hash.slice(1)); // an address may open a figure: #figure-1
  if (named && named.matches("figure[data-curves]")) named.querySelector("button.explore").click();
})();
