// Each figure with curves gets a button: its panels then become charts to zoom and to read values from.
(() => {
  "use strict";
  const element = (tag, name, text = "") => {
    const made = document.createElement(tag);
    made.className = name;
    made.textContent = text;
    return made;
  };

  // The curves of a figure lie packed beside it: JSON, gzip, base64.
  async function unpacked(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return JSON.parse(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text());
  }

  // A number with the digits that can be told apart in what is in sight; on a logarithmic axis four.
  function number(value, scale, log) {
    if (value === null) return "–";
    const apart = log ? 0 : (scale.max - scale.min) / 1000;
    const decimals = Math.ceil(-Math.log10(apart));
    return apart > 0 && decimals <= 12 ? value.toFixed(Math.max(0, decimals)) : String(Number(value.toPrecision(4)));
  }

  // Where a logarithmic axis has its ticks: powers of ten, below two of them 1, 2 and 5 of each, closer in as even steps.
  function logarithmic(low, high) {
    const decades = Math.log10(high / low), first = Math.floor(Math.log10(low)), found = [];
    if (decades < 0.7) {
      const step = 10 ** Math.floor(Math.log10((high - low) / 2));
      for (let k = Math.ceil(low / step); k * step <= high && found.length < 30; k++) found.push(k * step);
      return found;
    }
    const apart = Math.ceil(decades / 8), factors = decades < 2 ? [1, 2, 5] : [1];
    for (let e = Math.ceil(first / apart) * apart - apart; e <= first + decades + 1; e += apart)
      for (const f of factors) if (f * 10 ** e >= low * 0.999999 && f * 10 ** e <= high * 1.000001) found.push(f * 10 ** e);
    return found;
  }

  // A tick of such an axis: 0.001 to 1000 in full, others as 10⁻⁶ or 2·10⁶.
  function short(value) {
    const exponent = Math.floor(Math.log10(value) + 1e-9), factor = Number((value / 10 ** exponent).toPrecision(4));
    if (exponent >= -3 && exponent <= 3) return String(Number(value.toPrecision(5)));
    const power = "10" + String(exponent).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] || "⁻");
    return factor === 1 ? power : `${factor}·${power}`;
  }

  // Value of a curve at x: on the line between two points as it is drawn; of bars and single points the nearest one.
  function reading(series, x, panel, span) {
    const { x: xs, y: ys } = series;
    let low = 0, high = xs.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (xs[middle] < x) low = middle + 1; else high = middle;
    }
    const near = low === 0 ? 0 : low === xs.length || x - xs[low - 1] < xs[low] - x ? low - 1 : low;
    if (series.widths) return Math.abs(xs[near] - x) <= series.widths[near] / 2 ? ys[near] : null;
    if (xs[near] === x) return ys[near];
    if (series.width === 0) return Math.abs(xs[near] - x) < 0.02 * span ? ys[near] : null;
    if (low === 0 || low === xs.length || ys[low - 1] === null || ys[low] === null) return null;
    const along = (side, v) => (side.log ? Math.log(v) : v);
    const [x0, x1, at] = [xs[low - 1], xs[low], x].map((v) => along(panel.x, v));
    const [y0, y1] = [ys[low - 1], ys[low]].map((v) => along(panel.y, v));
    const y = y0 + ((y1 - y0) * (at - x0)) / (x1 - x0);
    return panel.y.log ? Math.exp(y) : y;
  }

  // Curves of one name and colour are one entry: its value, or from the least to the largest; a click hides them.
  function legend(panel) {
    const list = element("ul", "reading");
    const at = element("span", "value", "–");
    const first = element("li", "");
    first.append(element("span", "", panel.x.label || "x"), at);
    list.append(first);
    const groups = new Map();
    panel.series.forEach((s, k) => {
      const name = s.label || panel.y.label || "value", key = name + s.colour + (s.dash || "");
      if (!groups.has(key)) {
        const item = element("li", ""), button = element("button", "series"), value = element("span", "value", "–");
        const mark = element("span", "swatch");
        mark.style.background = s.colour;
        button.type = "button";
        button.append(mark, name);
        item.append(button, value);
        list.append(item);
        groups.set(key, { button, value, members: [] });
      }
      groups.get(key).members.push(k);
    });
    const show = (u, x) => {
      at.textContent = number(x, u.scales.x, panel.x.log);
      for (const { value, members } of groups.values()) {
        const span = u.scales.x.max - u.scales.x.min;
        const read = x === null ? [] : members.map((k) => reading(panel.series[k], x, panel, span)).filter((v) => v !== null);
        const ends = read.length ? [...new Set([Math.min(...read), Math.max(...read)].map((v) => number(v, u.scales.y, panel.y.log)))] : ["–"];
        value.textContent = ends.join(" … ");
      }
    };
    const clickable = (u) => {
      for (const { button, members } of groups.values()) {
        button.setAttribute("aria-pressed", "true");
        button.addEventListener("click", () => {
          const on = button.getAttribute("aria-pressed") !== "true";
          button.setAttribute("aria-pressed", String(on));
          for (const k of members) u.setSeries(k + 1, { show: on });
        });
      }
    };
    return { list, show, clickable };
  }

  function chart(panel, place) {
    const tables = panel.series.map((s) => [s.x, s.y]);
    const data = tables.length > 1 ? uPlot.join(tables, tables.map((t) => t.map(() => 1))) : tables[0];
    // What is in sight: the range of the picture first, then what was dragged over; never that of the data.
    const sight = { x: panel.x.range, y: panel.y.range };
    const reset = (u) => u.batch(() => ["x", "y"].forEach((side) => {
      const [min, max] = panel[side].range;
      u.setScale(side, { min, max });
    }));
    let dragged = false;
    const scale = (name) => ({
      time: false, distr: panel[name].log ? 3 : 1, range: (_, low, high) => (dragged && name === "x" ? [low, high] : sight[name]),
    });
    const axis = (side, size) => ({
      label: side.label, stroke: "#444", grid: { stroke: "#e3e5e8", width: 1 }, ticks: { stroke: "#999", width: 1 }, size, labelSize: 22,
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
      ...(side.log ? { splits: (_u, _k, low, high) => logarithmic(low, high), filter: (_, at) => at, values: (_, at) => at.map(short) } : {}),
    });
    const bands = [];
    const series = panel.series.map((s, k) => {
      if (s.band === 1) bands.push({ series: [k + 1, k], fill: s.colour + "40" });
      return {
        label: s.label, stroke: s.colour, width: s.width, dash: s.dash, spanGaps: false,
        points: { show: Boolean(s.points), size: 5, fill: s.colour }, ...(s.widths ? { paths: bars(s), fill: s.colour } : {}),
      };
    });
    const width = Math.max(280, place.clientWidth - 16);
    const { list, show, clickable } = legend(panel);
    if (panel.title) place.append(element("p", "panel-title", panel.title));
    const made = new uPlot({
      width, height: Math.round(Math.min(380, Math.max(240, 0.42 * width))), bands, pxAlign: 0,
      scales: { x: scale("x"), y: scale("y") },
      axes: [axis(panel.x, 36), axis(panel.y, 60)],
      series: [{}, ...series],
      cursor: { drag: { x: true, y: true, uni: 25 }, points: { show: false }, bind: { dblclick: (u) => () => reset(u) } },
      legend: { show: false },
      hooks: { ready: [() => { dragged = true; }], setScale: [(u, name) => { sight[name] = [u.scales[name].min, u.scales[name].max]; }], setCursor: [(u) => show(u, u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null)] },
    }, data, place);
    clickable(made);
    place.append(list);
  }

  // Bars of their own widths, from zero.
  function bars(s) {
    return (u) => {
      const fill = new Path2D(), { top, height } = u.bbox;
      const zero = u.scales.y.distr === 3 ? top + height : u.valToPos(0, "y", true);
      s.x.forEach((x, k) => {
        if (s.y[k] === null) return;
        const [left, right] = [-0.5, 0.5].map((side) => u.valToPos(x + side * s.widths[k], "x", true));
        fill.rect(left, zero, Math.max(1, right - left - 1), u.valToPos(s.y[k], "y", true) - zero);
      });
      return { stroke: null, fill };
    };
  }

  function openable(figure) {
    const button = element("button", "explore", "Zoom and read values");
    const picture = figure.querySelector("img");
    let place = null, curves = null;
    button.type = "button";
    button.setAttribute("aria-expanded", "false");
    const turn = async () => {
      if (place === null) {
        place = element("div", "plots");
        place.hidden = true;
        curves = await unpacked(figure.dataset.curves);
        picture.after(place);
      }
      const open = place.hidden;
      place.hidden = !open;
      if (open && !place.firstChild) {
        place.append(element("p", "hint", "Drag over a part to zoom, double-click to see all. Below: the values at the cursor; a click on a name hides its curves."));
        for (const panel of curves.panels) chart(panel, place);
      }
      picture.hidden = open && curves.whole;
      button.textContent = open ? "Back to the picture" : "Zoom and read values";
      button.setAttribute("aria-expanded", String(open));
    };
    button.addEventListener("click", turn);
    picture.addEventListener("dblclick", turn);
    figure.append(button);
  }

  if (!("DecompressionStream" in window)) return; // a browser of before 2023: the pictures stay
  document.querySelectorAll("figure[data-curves]").forEach(openable);
  const named = document.getElementById(location.hash.slice(1)); // an address may open a figure: #figure-1
  if (named && named.matches("figure[data-curves]")) named.querySelector("button.explore").click();
})();
