"use strict";
// Draws the report's figures from the data in the page. Curves over time are unpacked when they are asked
// for, and thinned to what a screen can show of the stretch in view.
(async function () {
  function inflate(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
  }
  const library = document.createElement("script"); // plotly.js, which the page holds compressed
  library.textContent = await inflate(document.getElementById("plotly-script").textContent).text();
  document.head.append(library);
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const { controllers, channels, earthquakes } = data;
  const $ = (id) => document.getElementById(id);
  const narrow = () => window.innerWidth < 700;
  const INK = "#1b2530", GRID = "#dddddd", TARGET = "#9a9a9a", LIMIT = "#5b5b5b";
  const STRONG = 5.0; // [s] first shown
  const MOST = 2400; // points of a curve on the screen
  const chosen = controllers.map((each) => each.shown);

  const config = {
    responsive: true, displaylogo: false, displayModeBar: narrow() ? false : "hover",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
    toImageButtonOptions: { format: "svg", filename: "shake" },
  };
  const axis = (title, extra) => Object.assign({
    title: { text: title, font: { size: 13 }, standoff: 8 }, gridcolor: GRID, zeroline: false, linecolor: INK,
    showline: true, ticks: "outside", ticklen: 4, tickcolor: INK, automargin: true, exponentformat: "power",
  }, extra);
  const layout = (extra) => Object.assign({
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: INK },
    paper_bgcolor: "#fff", plot_bgcolor: "#fff", height: 400, hovermode: "closest",
    dragmode: narrow() ? false : "zoom", // a finger scrolls the page
    margin: { l: 60, r: 12, t: narrow() ? 12 : 30, b: 46 },
    legend: { orientation: "h", x: 0, y: -0.2, yanchor: "top", font: { size: 12 }, traceorder: "normal" },
  }, extra);
  const line = (k, width) => ({ color: controllers[k].color, dash: controllers[k].dash, width: width || 1.8 });
  const short = (value) => value === null ? "–" : value >= 100 ? value.toFixed(0) : value.toPrecision(3);
  const decades = (values) => {
    const known = values.filter((v) => v > 0);
    const low = Math.min(...known), high = Math.max(...known);
    const ticks = [], wide = high / low;
    const steps = wide > 300 ? [1] : wide > 20 ? [1, 3] : wide > 6 ? [1, 2, 5] : wide > 2.5 ? [1, 1.5, 2, 3, 4, 5, 7]
      : Array.from({ length: 18 }, (_, i) => 1 + i / 2);
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) {
      for (const m of steps) ticks.push(m * 10 ** e);
    }
    return { type: "log", tickvals: ticks, ticktext: ticks.map((t) => String(+t.toPrecision(3))) };
  };

  // --- curves over time ---------------------------------------------------------------------------
  async function unpack(packed) {
    if (packed.curves) return packed.curves;
    const numbers = new Uint8Array(await inflate(packed.blob).arrayBuffer());
    const curves = {};
    let at = 0;
    for (const [name, scale] of Object.entries(packed.scales)) {
      const curve = new Float32Array(packed.samples);
      let level = 0;
      for (let i = 0; i < packed.samples; i++) {
        let value = numbers[at++];
        if (value > 127) value = (value & 127) | (numbers[at++] << 7);
        level += value & 1 ? -((value + 1) >> 1) : value >> 1;
        curve[i] = scale * level;
      }
      curves[name] = curve;
    }
    packed.curves = curves;
    return curves;
  }
  // The lowest and the highest value of each stretch, in their order: it looks the same.
  function seen(curve, rate, from, to) {
    const first = Math.max(0, Math.floor(from * rate) - 2), last = Math.min(curve.length, Math.ceil(to * rate) + 2);
    const width = Math.max(1, Math.floor((2 * (last - first)) / MOST));
    const x = [], y = [];
    for (let i = first; i < last; i += width) {
      let low = i, high = i;
      for (let j = i; j < Math.min(i + width, last); j++) {
        if (curve[j] < curve[low]) low = j;
        if (curve[j] > curve[high]) high = j;
      }
      for (const j of low === high ? [low] : low < high ? [low, high] : [high, low]) {
        x.push((j + 1) / rate);
        y.push(curve[j]);
      }
    }
    return { x, y };
  }
  let current = data.first, window_ = null;
  const duration = (quake) => quake.target.samples / quake.target.rate;
  async function strongest(quake) {
    const curves = await unpack(quake.target);
    let peak = 0;
    curves.shear.forEach((v, i) => { if (Math.abs(v) > Math.abs(curves.shear[peak])) peak = i; });
    const whole = duration(quake);
    const from = Math.min(Math.max(peak / quake.target.rate - 0.4 * STRONG, 0), Math.max(whole - STRONG, 0));
    return [from, Math.min(from + STRONG, whole)];
  }
  async function traces() {
    const quake = earthquakes[current], target = await unpack(quake.target);
    const picked = controllers.map((_, k) => k).filter((k) => chosen[k] && quake.runs[k].samples > 0);
    const runs = await Promise.all(picked.map((k) => unpack(quake.runs[k])));
    const [from, to] = window_;
    const list = [], notes = [], shapes = [];
    const rows = channels.length, gap = 0.055, share = (1 - gap * (rows - 1)) / rows;
    const shape = layout({
      height: narrow() ? 900 : 960, margin: { l: 52, r: 10, t: 28, b: 46 },
      legend: { orientation: "h", x: 0, y: 1.035, yanchor: "bottom", font: { size: 12 }, traceorder: "normal" },
    });
    channels.forEach((channel, row) => {
      const n = row === 0 ? "" : row + 1, top = 1 - row * (share + gap);
      const add = (points, name, style, first) => list.push(Object.assign({
        type: "scatter", mode: "lines", x: points.x, y: points.y, name, line: style, xaxis: "x" + n,
        yaxis: "y" + n, legendgroup: name, showlegend: first,
        hovertemplate: `%{y:.3g} ${channel.unit} at %{x:.3f} s<extra>${name}</extra>`,
      }));
      let largest = 0;
      const note = (points) => points.y.forEach((v) => { largest = Math.max(largest, Math.abs(v)); });
      if (channel.targeted) {
        const points = seen(target[channel.key], quake.target.rate, from, to);
        note(points);
        add(points, "target (real ground)", { color: TARGET, width: 4 }, row === 0);
      }
      picked.forEach((k, place) => {
        const points = seen(runs[place][channel.key], quake.runs[k].rate, from, to);
        note(points);
        add(points, controllers[k].label, line(k, 1.5), row === 0);
      });
      const limit = channel.limit, near = limit !== null && limit < 3.5 * largest;
      if (near) {
        for (const side of [-limit, limit]) {
          shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, yref: "y" + n, y0: side, y1: side, layer: "below",
            line: { color: LIMIT, width: 1.3, dash: "8px,4px" } });
        }
      }
      const words = limit === null ? "" : near ? `, dashed: limit ±${+limit.toPrecision(3)}`
        : `, limit ±${+limit.toPrecision(3)} ${narrow() ? "far off" : "is far outside"}`;
      notes.push({ text: `<b>${channel.title}</b> [${channel.unit}]${words}`, xref: "paper", yref: "paper", x: 0, y: top,
        xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12.5 } });
      const reach = 1.06 * Math.max(largest, near ? limit : 0, 1e-9);
      shape["xaxis" + n] = axis(row === rows - 1 ? `time of ${quake.name} [s]` : "", {
        range: [from, to], matches: row === 0 ? undefined : "x", showticklabels: row === rows - 1, anchor: "y" + n,
        ticks: row === rows - 1 ? "outside" : "" });
      shape["yaxis" + n] = axis("", { domain: [top - share, top], range: [-reach, reach], anchor: "x" + n, nticks: 5,
        fixedrange: true, zeroline: true, zerolinecolor: "#b5b5b5" });
    });
    await Plotly.react("traces", list, Object.assign(shape, { annotations: notes, shapes }),
      Object.assign({}, config, { doubleClick: false }));
    $("window").value = `${from.toFixed(1)} to ${to.toFixed(1)} s of ${duration(quake).toFixed(1)} s`;
  }
  async function loops() {
    if (!data.hysteresis) return;
    const quake = earthquakes[current];
    const list = [["target (real ground)", quake.target, { color: TARGET, width: 4 }]];
    controllers.forEach((c, k) => { if (chosen[k]) list.push([c.label, quake.runs[k], line(k, 1.4)]); });
    const drawn = [];
    for (const [name, packed, style] of list) {
      const curves = await unpack(packed), [from, to] = window_.map((t) => Math.round(t * packed.rate));
      drawn.push({ type: "scatter", mode: "lines", name, line: style, x: Array.from(curves.drift.slice(from, to)),
        y: Array.from(curves.shear.slice(from, to)) });
    }
    await Plotly.react("hysteresis", drawn, layout({
      height: 480, xaxis: axis("drift of the first storey [mm]"), yaxis: axis("base shear [kN]"),
    }), config);
  }
  function spectra() {
    const quake = earthquakes[current], x = data.periods, [target, ...runs] = quake.spectra;
    const band = (low, high, name) => [
      { x, y: high, mode: "lines", line: { width: 0 }, showlegend: false, hoverinfo: "skip" },
      { x, y: low, mode: "lines", line: { width: 0 }, fill: "tonexty", fillcolor: "rgba(154,154,154,0.32)", name, hoverinfo: "skip" },
    ];
    const share = data.tolerance, periods = { type: "log", tickvals: [0.05, 0.1, 0.2, 0.5, 1, 2], range: [Math.log10(0.05), Math.log10(2)] };
    const kept = controllers.map((_, k) => k).filter((k) => chosen[k]);
    const curves = (rows) => kept.map((k) => ({ x, y: rows[k], mode: "lines", name: controllers[k].label, line: line(k, 1.8) }));
    const within = `target ± ${100 * share} %`;
    const tall = Math.max(...target.map((v) => v * (1 + share)).concat(...kept.map((k) => runs[k])));
    Plotly.react("spectrum", [
      ...band(target.map((v) => v * (1 - share)), target.map((v) => v * (1 + share)), within),
      { x, y: target, mode: "lines", name: "target", line: { color: TARGET, width: 3.5 } },
      ...curves(runs),
    ], layout({ xaxis: axis("period [s]", periods), yaxis: axis("pseudo-acceleration [m/s²]", { range: [0, 1.06 * tall] }) }), config);
    const ratios = kept.flatMap((k) => data.ratios[k]).filter((v) => v !== null);
    if (ratios.length && $("ratio")) {
      Plotly.react("ratio", [
        ...band(x.map(() => 1 - share), x.map(() => 1 + share), `1 ± ${share}`),
        ...curves(data.ratios).filter((c) => c.y.some((v) => v !== null)),
      ], layout({ xaxis: axis("period [s]", periods), yaxis: axis("achieved / target [-]", {
        range: [Math.min(0.8, 0.97 * Math.min(...ratios)), Math.max(1.2, 1.03 * Math.max(...ratios))] }) }), config);
    }
  }
  function errors() {
    earthquakes[current].errors.forEach(([acceleration, shear, ended], k) => {
      $("errors-" + k).value = ended ? `ended: ${ended.replaceAll("_", " ")}` : `acceleration ${short(acceleration)} %, shear ${short(shear)} %`;
    });
  }

  // --- figures of all earthquakes -----------------------------------------------------------------
  function transfer() {
    const found = data.transfer;
    if (!found) return;
    const ticks = { type: "log", tickvals: [0.5, 1, 2, 5, 10, 20, 50] };
    for (const [id, rows, title] of [["transfer-acceleration", found.acceleration, "acceleration error / target [-]"],
      ["transfer-shear", found.shear, "base shear error / target [N/(m/s²)]"]]) {
      const list = controllers.map((c, k) => ({ x: found.frequency[k], y: rows[k], mode: "lines", name: c.label, line: line(k, 1.9) }));
      Plotly.newPlot(id, list, layout({ xaxis: axis("frequency [Hz]", ticks), yaxis: axis(title, decades(rows.flat())) }), config);
    }
  }
  function tradeOff() {
    // A table that stands still is off by all of both, and would squeeze the others into a corner.
    const found = data.tradeOff, list = [], percent = (v) => 100 * v, moving = controllers.map((_, k) => k)
      .filter((k) => found.means[k].some(([mean]) => Math.abs(mean - 1) > 1e-6));
    if (found.frontier.length) {
      list.push({ x: found.frontier.map((p) => percent(p[0])), y: found.frontier.map((p) => percent(p[1])), mode: "lines",
        name: "LQR of every weighting, expected", line: { color: TARGET, width: 3 } });
    }
    moving.forEach((k) => {
      const each = found.each[k], c = controllers[k];
      if (each.length > 1) {
        list.push({ x: each.map((p) => percent(p[0])), y: each.map((p) => percent(p[1])), mode: "markers", legendgroup: c.label,
          showlegend: false, marker: { color: c.color, symbol: c.symbol, size: 5, opacity: 0.3 }, hoverinfo: "skip" });
      }
    });
    const bars = ([mean, low, high]) => ({ type: "data", symmetric: false, array: [percent(high - mean)],
      arrayminus: [percent(mean - low)], thickness: 1.6, width: 5, visible: high > low });
    moving.forEach((k) => {
      const [a, s] = found.means[k], c = controllers[k];
      list.push({ x: [percent(a[0])], y: [percent(s[0])], mode: "markers", name: c.label, legendgroup: c.label,
        marker: { color: c.color, symbol: c.symbol, size: 12, line: { color: "#fff", width: 1.2 } },
        error_x: Object.assign(bars(a), { color: c.color }), error_y: Object.assign(bars(s), { color: c.color }) });
    });
    const every = (i) => list.flatMap((t) => (i ? t.y : t.x));
    Plotly.newPlot("trade-off", list, layout({ height: 480,
      xaxis: axis("acceleration error [% of the target's rms]", decades(every(0))),
      yaxis: axis("base shear error [% of the target's rms]", decades(every(1))) }), config);
  }
  function robustness() {
    const found = data.robustness;
    if (!found) return;
    const [first, second] = found.parameters, kept = controllers.map((_, k) => k).filter((k) => chosen[k]);
    if (!second) {
      Plotly.newPlot("robustness", kept.map((k) => ({ x: first.values, y: found.error[k], mode: "markers", name: controllers[k].label,
        marker: { color: controllers[k].color, symbol: controllers[k].symbol, size: 7 } })),
      layout({ xaxis: axis(first.label), yaxis: axis("base shear error [%]", decades(found.error.flat())) }), config);
      return;
    }
    const columns = narrow() ? 1 : Math.min(kept.length, 2), rows = Math.ceil(kept.length / columns);
    const known = kept.flatMap((k) => found.error[k]).filter((v) => v !== null).sort((a, b) => a - b);
    const high = known[Math.floor(0.95 * (known.length - 1))], low = known[0];
    const list = [], notes = [], across = columns === 1 ? 1 : 0.46, tall = rows === 1 ? 1 : 1 / rows - 0.11;
    const shape = layout({ height: 110 + 300 * rows, showlegend: false, margin: { l: 60, r: 86, t: 30, b: 50 } });
    kept.forEach((k, place) => {
      const n = place === 0 ? "" : place + 1, column = place % columns, row = Math.floor(place / columns);
      const left = column * 0.54, top = 1 - row * (tall + (rows === 1 ? 0 : 0.11 * rows / (rows - 1)));
      list.push({ x: first.values, y: second.values, mode: "markers", name: controllers[k].label, xaxis: "x" + n, yaxis: "y" + n,
        text: found.error[k], hovertemplate: "base shear error %{text} %<extra></extra>",
        marker: { color: found.error[k], colorscale: "Cividis", reversescale: true, cmin: low, cmax: high, showscale: place === 0,
          size: found.error[k].map((v) => 6 + 14 * Math.sqrt(Math.min(v, high) / high)), line: { color: INK, width: 0.6 },
          colorbar: { title: { text: "base shear<br>error [%]" }, thickness: 12, outlinewidth: 0, x: 1.02 } } });
      notes.push({ text: `<b>${controllers[k].label}</b>`, xref: "paper", yref: "paper", x: left, y: top, xanchor: "left",
        yanchor: "bottom", showarrow: false, font: { size: 13 } });
      shape["xaxis" + n] = axis(row === rows - 1 || place + columns >= kept.length ? first.label : "", { domain: [left, left + across], anchor: "y" + n });
      shape["yaxis" + n] = axis(column === 0 ? second.label : "", { domain: [Math.max(0, top - tall), top], anchor: "x" + n });
    });
    Plotly.react("robustness", list, Object.assign(shape, { annotations: notes }), config);
  }
  function learning() {
    if (!data.learning.length) return;
    const list = data.learning.map((run) => ({ x: run.steps.map((n) => n / 1e6), y: run.cost, mode: "lines+markers", line: line(run.controller, 2),
      name: controllers[run.controller].label, marker: { symbol: controllers[run.controller].symbol, size: 9 } }));
    Plotly.newPlot("learning", list, layout({ showlegend: list.length > 1, xaxis: axis("control periods trained on [million]", { rangemode: "tozero" }),
      yaxis: axis("cost / reference [-]", decades(data.learning.flatMap((run) => run.cost))),
      shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: LIMIT, width: 1.3, dash: "8px,4px" } }] }), config);
  }

  // --- what the reader chooses --------------------------------------------------------------------
  async function show(from, to) {
    window_ = [from, to];
    await traces();
    await loops();
  }
  async function choose() {
    errors();
    spectra();
    await show(...(await strongest(earthquakes[current])));
  }
  $("earthquake").addEventListener("change", (event) => { current = Number(event.target.value); choose(); });
  $("strong").addEventListener("click", async () => show(...(await strongest(earthquakes[current]))));
  const within = (from, to) => {
    const whole = duration(earthquakes[current]), span = Math.min(Math.max(to - from, 0.2), whole);
    const start = Math.min(Math.max(from, 0), whole - span);
    return show(start, start + span);
  };
  const move = (share) => within(...window_.map((t) => t + share * (window_[1] - window_[0])));
  const zoom = (factor) => {
    const middle = (window_[0] + window_[1]) / 2, half = (factor * (window_[1] - window_[0])) / 2;
    return within(middle - half, middle + half);
  };
  $("earlier").addEventListener("click", () => move(-0.5));
  $("later").addEventListener("click", () => move(0.5));
  $("closer").addEventListener("click", () => zoom(0.5));
  $("wider").addEventListener("click", () => zoom(2));
  $("whole").addEventListener("click", () => show(0, duration(earthquakes[current])));
  controllers.forEach((_, k) => $("controller-" + k).addEventListener("change", async (event) => {
    chosen[k] = event.target.checked;
    spectra();
    robustness();
    await traces();
    await loops();
  }));
  await choose();
  $("traces").on("plotly_relayout", (change) => {
    const key = Object.keys(change).find((name) => /^xaxis\d*\.(range\[0\]|autorange)$/.test(name));
    if (!key) return;
    const from = change[key.split(".")[0] + ".range[0]"], to = change[key.split(".")[0] + ".range[1]"];
    if (key.endsWith("autorange")) show(0, duration(earthquakes[current]));
    else if (from !== undefined && (from !== window_[0] || to !== window_[1])) show(Math.max(0, from), Math.min(to, duration(earthquakes[current])));
  });
  $("traces").on("plotly_doubleclick", () => show(0, duration(earthquakes[current])));
  tradeOff();
  transfer();
  robustness();
  learning();

  // Paper is narrower than most screens: drawn again at its width, and back.
  const paper = (width) => document.querySelectorAll(".plot").forEach((plot) => {
    if (plot.data) Plotly.relayout(plot, width ? { width, autosize: false } : { width: null, autosize: true });
  });
  window.addEventListener("beforeprint", () => paper(680));
  window.addEventListener("afterprint", () => paper(null));
  document.documentElement.dataset.drawn = "yes";
})();
