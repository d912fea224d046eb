// The figures: Plotly draws them, a line shows the time of the playback.

const DASHES = ["solid", "dash", "dashdot", "dot"];
const MARGIN = { l: 58, r: 14, t: 14, b: 46 };
const IN_A_ROW = 4; // of the legend
const LEGEND_ROW = 19; // pixels
const MORE_ROWS = 3; // from which on a figure grows with its legend
const MOST_UNIFIED = 8; // curves in one hover box

/** Rows of the legend of a chart; 0 without one. */
function legendRows(chart) {
  const count = chart.curves.filter((one) => !one.other).length;
  return chart.curves.length < 2 ? 0 : count > 5 ? Math.ceil(count / IN_A_ROW) : 1;
}

class Figures {
  constructor(box, charts, state, seek) {
    this.box = box;
    this.state = state;
    this.seek = seek;
    this.charts = charts.map((chart) => this.card(chart));
    this.now = 0;
    this.syncing = false;
    this.library = null;
    // Drawn when they come near: ten figures at once would hold the page up.
    const watch = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        watch.unobserve(entry.target);
        this.plot(this.charts.find((one) => one.card === entry.target));
      }
    }, { rootMargin: "500px" });
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        const one = this.charts.find((other) => other.card === entry.target);
        one.seen = entry.isIntersecting;
        this.mark(one);
      }
    });
    for (const one of this.charts) {
      watch.observe(one.card);
      seen.observe(one.card);
    }
  }

  card(chart) {
    const card = document.createElement("section");
    card.className = chart.key === "errors" ? "chart wide" : "chart";
    card.id = `chart-${chart.key}`;
    const title = document.createElement("h2");
    title.textContent = chart.title + (chart.unit ? ` [${chart.unit}]` : "");
    const plot = document.createElement("div");
    plot.className = "plot";
    const more = legendRows(chart) - MORE_ROWS;
    if (more > 0) plot.style.height = `${(chart.key === "errors" ? 380 : 320) + LEGEND_ROW * more}px`;
    const cursor = document.createElement("div");
    cursor.className = "cursor";
    cursor.hidden = true;
    plot.append(cursor);
    card.append(title, plot);
    const shaded = [["band", chart.band && chart.band_label], ["span", chart.spans.length && chart.spans_label]].filter(([, words]) => words);
    if (chart.note || shaded.length) {
      const note = document.createElement("p");
      note.className = "note";
      note.append(chart.note);
      for (const [kind, words] of shaded) {
        const swatch = Object.assign(document.createElement("span"), { className: `swatch ${kind}` });
        const shade = Object.assign(document.createElement("span"), { className: "shade" });
        shade.append(swatch, words); // together on a line
        note.append(shade, " ");
      }
      card.append(note);
    }
    this.box.append(card);
    return { chart, card, plot, cursor, asked: false, drawn: false, seen: false };
  }

  /** Draw all the others while nothing else is to be done: what is printed or searched is complete. */
  rest() {
    const next = this.charts.find((one) => !one.asked);
    const idle = window.requestIdleCallback || ((call) => setTimeout(call, 200));
    if (next) idle(() => this.plot(next).then(() => this.rest()));
  }

  async plot(one) {
    if (one.asked) return;
    one.asked = true;
    this.library ??= loadPlotly();
    await this.library;
    const config = {
      displaylogo: false, responsive: true, doubleClick: "reset",
      modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
      toImageButtonOptions: { filename: one.chart.key, scale: 2 },
    };
    await Plotly.newPlot(one.plot, this.traces(one.chart), this.layout(one.chart), config);
    one.plot.append(one.cursor);
    one.drawn = true;
    one.plot.on("plotly_click", (event) => this.seek(event.points[0].x));
    one.plot.on("plotly_relayout", (change) => this.zoomed(one, change));
    one.plot.on("plotly_afterplot", () => this.mark(one));
    this.mark(one);
  }

  traces(chart) {
    return chart.curves.map((curve) => ({
      type: "scatter", mode: "lines", name: curve.label, showlegend: !curve.other, x: curve.t, y: curve.values,
      line: { color: this.state.colour(curve), dash: DASHES[curve.dash], width: 1.6 },
      visible: this.visible(curve), hovertemplate: `%{y:.4~g} ${chart.unit}`,
    }));
  }

  visible(curve) {
    return !curve.uavs.some((uav) => this.state.hidden.has(uav));
  }

  layout(chart) {
    const colour = (name) => this.state.style[name];
    const axis = {
      gridcolor: colour("--grid"), tickfont: { size: 12 }, linecolor: colour("--rule"), zeroline: false, ticks: "outside",
      tickcolor: colour("--rule"), ticklen: 4, automargin: false,
    };
    const rows = legendRows(chart);
    const legend = rows > 0;
    return {
      // Curves of the live view grow in place, which Plotly would not see.
      datarevision: chart.curves.length ? chart.curves[0].t.length : 0,
      margin: { ...MARGIN, b: MARGIN.b + (legend ? 3 + LEGEND_ROW * rows : 0) }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("--soft"), size: 12, family: "system-ui, sans-serif" },
      xaxis: { ...axis, title: { text: "time after the epoch [s]", standoff: 6 }, hoverformat: ".2f",
        // The same span for all over the whole time, so that their lines stand below each other.
        range: [this.state.clock.begin, this.state.clock.end] },
      yaxis: { ...axis, ...(chart.floor
        ? { type: "log", range: [Math.log10(chart.floor), null], exponentformat: "power", dtick: 1, tickfont: { size: 9.5 } }
        : { rangemode: "tozero" }) },
      showlegend: legend,
      // Shown and hidden in one place for all figures, not here.
      legend: { orientation: "h", yref: "container", y: 0, yanchor: "bottom", font: { size: 11.5 },
        itemclick: false, itemdoubleclick: false },
      hovermode: chart.curves.length > MOST_UNIFIED ? "closest" : "x unified",
      hoverlabel: { bgcolor: colour("--card"), bordercolor: colour("--rule"), font: { color: colour("--ink") } },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--soft"), activecolor: colour("--accent") },
      dragmode: "zoom", ...this.lines(chart, colour),
    };
  }

  lines(chart, colour) {
    const shapes = [];
    const annotations = [];
    const words = (text, more) => annotations.push({
      text, showarrow: false, font: { size: 11, color: colour("--ink") }, bgcolor: colour("--card"), borderpad: 1, opacity: 0.85, ...more });
    for (const [begin, end] of chart.spans) {
      shapes.push({ type: "rect", x0: begin, x1: end, yref: "paper", y0: 0, y1: 1, layer: "below",
        fillcolor: colour("--soft"), opacity: 0.12, line: { width: 0 } });
    }
    if (chart.band) {
      shapes.push({ type: "rect", xref: "paper", x0: 0, x1: 1, y0: chart.band[0], y1: chart.band[1], layer: "below",
        fillcolor: "#009E73", opacity: 0.13, line: { width: 0 } });
    }
    for (const [value, label] of chart.limits) {
      shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: value, y1: value,
        line: { color: colour("--ink"), width: 1.2, dash: "dot" } });
      // On the left: on the right it would stand under the tool bar.
      words(label, { xref: "paper", x: 0, xanchor: "left", y: chart.floor ? Math.log10(value) : value, yanchor: "bottom" });
    }
    for (const [time, label] of chart.marks) {
      shapes.push({ type: "line", yref: "paper", y0: 0, y1: 1, x0: time, x1: time,
        line: { color: colour("--ink"), width: 1.4 } });
      words(label, { yref: "paper", y: 1, yanchor: "top", x: time, xanchor: "left", xshift: 1, textangle: -90 });
    }
    return { shapes, annotations };
  }

  /** Colours or hidden UAVs have changed. */
  refresh() {
    for (const one of this.charts) {
      if (!one.drawn) continue;
      const { chart, plot } = one;
      const range = plot.layout.xaxis.autorange === false ? [...plot.layout.xaxis.range] : null;
      const layout = this.layout(chart);
      if (range) layout.xaxis = { ...layout.xaxis, range, autorange: false };
      Plotly.react(plot, this.traces(chart), layout);
    }
  }

  /** Whoever zooms in time takes the others along. */
  zoomed(one, change) {
    this.mark(one);
    if (this.syncing) return;
    const range = change["xaxis.range"] || [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const whole = change["xaxis.autorange"];
    if (!whole && !Number.isFinite(range[0])) return;
    this.syncing = true;
    const others = this.charts.filter((other) => other !== one && other.drawn);
    const wish = whole ? { "xaxis.autorange": true } : { "xaxis.range": [...range], "xaxis.autorange": false };
    Promise.all(others.map((other) => Plotly.relayout(other.plot, wish))).finally(() => { this.syncing = false; });
  }

  /** Draw all figures that are drawn in another size, with room for its legend; null: as wide as their cards. */
  resize(size) {
    for (const { chart, plot, drawn } of this.charts) {
      if (!drawn) continue;
      const more = Math.max(legendRows(chart) - MORE_ROWS, 0) * LEGEND_ROW;
      Plotly.relayout(plot, size ? { width: size.width, height: size.height + more } : { width: null, height: null, autosize: true });
    }
  }

  show(now) {
    this.now = now;
    for (const one of this.charts) this.mark(one);
  }

  mark({ plot, cursor, drawn, seen }) {
    const axis = drawn && seen && plot._fullLayout && plot._fullLayout.xaxis;
    if (!axis || !axis._length) return;
    const x = axis.l2p(this.now);
    cursor.hidden = !(x >= 0 && x <= axis._length);
    const { t, h } = plot._fullLayout._size;
    cursor.style.height = `${h}px`;
    cursor.style.transform = `translate(${axis._offset + x}px, ${t}px)`;
  }
}

let plotlyLoading = null;

/** Unpack the library that the page carries. */
function loadPlotly() {
  plotlyLoading ??= inflated("plotly").then((buffer) => {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(buffer);
    document.head.append(script);
  });
  return plotlyLoading;
}
