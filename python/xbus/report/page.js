// Draws the plots one after the other, so that the page can be read while it loads.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isNarrow = (plot) => plot.clientWidth < 520;

  const axesOf = (layout) => Object.keys(layout).filter((key) => /^[xy]axis[0-9]*$/.test(key));

  const theme = (isDark, layout) => {
    const axis = { gridcolor: isDark ? "#333b45" : "#e3e7ec", zerolinecolor: isDark ? "#55606c" : "#b8c0c9", linecolor: isDark ? "#55606c" : "#b8c0c9" };
    const colours = { "modebar.bgcolor": "rgba(0,0,0,0)", "modebar.color": isDark ? "#77828e" : "#a2abb5", paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", "font.color": isDark ? "#e6e9ee" : "#1c2430" };
    for (const name of axesOf(layout)) for (const key in axis) colours[`${name}.${key}`] = axis[key];
    return colours;
  };
  const paint = (isDark, size) => plots.filter((plot) => plot.layout).forEach((plot) => Plotly.relayout(plot, { ...theme(isDark, plot.layout), ...size }));

  // Marks of a time axis: seconds, minutes and hours since the start, and UTC below where it is known.
  const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];
  const stepOf = (least) => {
    if (least > 86400) return 86400 * Math.ceil(least / 86400);
    if (least > 0.5) return STEPS.find((step) => step >= least);
    const power = 10 ** Math.floor(Math.log10(least));
    return power * [1, 2, 5, 10].find((factor) => factor * power >= least * 0.999999);
  };
  const elapsed = (seconds, unit, digits) => {
    const whole = Number(Math.abs(seconds).toFixed(digits));
    const rest = (whole % 60).toFixed(digits);
    const sign = seconds < 0 && whole ? "−" : "";
    if (unit === "s") return sign + whole.toFixed(digits);
    const minutes = Math.floor(whole / 60);
    const tail = rest.padStart(digits ? digits + 3 : 2, "0");
    if (unit === "min:s") return `${sign}${minutes}:${tail}`;
    return `${sign}${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${tail}`;
  };
  const utcAt = (clock, seconds) => {
    const piece = clock.findLast(([start]) => start <= seconds) ?? clock[0];
    return piece && piece[1] !== null ? new Date(Math.round(piece[1] + (seconds - piece[0]) * piece[2] * 1000)) : null;
  };
  const marks = (plot, figure) => {
    const range = plot.layout.xaxis.range;
    if (!figure.clock || !range) return {};
    const [from, to] = range.map(Number);
    const clock = figure.clock;
    const step = stepOf(Math.max(to - from, 1e-9) / Math.max(2, (plot.clientWidth - 90) / 100));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const most = Math.max(Math.abs(from), Math.abs(to));
    const unit = most <= 120 ? "s" : most < 7200 ? "min:s" : "h:min:s";
    const values = [];
    for (let at = Math.ceil(from / step - 1e-9); at * step <= to + step * 1e-9; at++) values.push(at * step);
    const days = new Set();
    const texts = values.map((value) => {
      const utc = utcAt(clock, value);
      if (utc) days.add(utc.toISOString().slice(0, 10));
      const more = utc && utc.getTime() % 1000 ? 23 : 19;
      return elapsed(value, unit, digits) + (utc ? `<br>${utc.toISOString().slice(11, more)}` : "");
    });
    const day = days.size > 1 ? `${[...days][0]} to ${[...days].at(-1)}` : [...days][0];
    return {
      "xaxis.tickmode": "array", "xaxis.tickvals": values, "xaxis.ticktext": texts,
      "xaxis.title.text": isNarrow(plot) ? `time, ${unit}${day ? `; UTC ${day}` : ""}` : `time since the start, ${unit}${day ? `; below, UTC of ${day}` : ""}`,
    };
  };

  // A zoom of one plot over time applies to all of the same recording.
  let isFollowing = false;
  const follow = (at, change) => {
    const leader = plots[at];
    if (isFollowing) return;
    isFollowing = true;
    const isZoom = Object.keys(change).some((key) => key.startsWith("xaxis.range") || key === "xaxis.autorange");
    const changed = isZoom ? plots.filter((plot, other) => plot.layout && figures[other].is_over_time && figures[other].recording === figures[at].recording) : [leader];
    const range = leader.layout.xaxis.range;
    Promise.all(changed.map((plot) => Plotly.relayout(plot, { ...(plot === leader ? {} : { "xaxis.range": range.slice() }), ...marks(leader, figures[at]) }))).finally(() => { isFollowing = false; });
  };

  const draw = (at) => {
    if (at === plots.length) {
      document.body.dataset.drawn = at;
      return;
    }
    const { data, layout, is_over_time } = figures[at];
    const axis = (own) => ({ automargin: true, ticks: "outside", exponentformat: "none", ...own, title: { standoff: 8, ...own.title } });
    const whole = {
      margin: { l: isNarrow(plots[at]) ? 60 : 70, r: 15, t: 28, b: 60 }, hovermode: "closest", font: { size: 12 },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.0, yanchor: "bottom" }, dragmode: "zoom",
      ...layout, ...Object.fromEntries(axesOf(layout).map((key) => [key, axis(layout[key])])),
    };
    // The time axes of all plots are aligned.
    if (is_over_time && !isNarrow(plots[at])) { whole.yaxis.automargin = false; whole.margin.l = 150; }
    const config = { displaylogo: false, responsive: true, displayModeBar: isNarrow(plots[at]) ? false : "hover" };
    Plotly.newPlot(plots[at], data, whole, config)
      .then((plot) => Plotly.relayout(plot, { ...theme(dark.matches, plot.layout), ...marks(plot, figures[at]) }))
      .then((plot) => {
        if (is_over_time) plot.on("plotly_relayout", (change) => follow(at, change));
        setTimeout(draw, 0, at + 1);
      });
  };

  dark.addEventListener("change", () => paint(dark.matches));
  // Paper is white, and narrower than a window: A4 and letter have 700 pixels between their margins.
  addEventListener("beforeprint", () => paint(false, { width: 700 }));
  addEventListener("afterprint", () => paint(dark.matches, { width: null, autosize: true }));
  draw(0);
})();
