// Draws the plots one after the other, so that the page can be read while it loads.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const config = { displaylogo: false, responsive: true };

  const theme = (isDark) => {
    const axis = { gridcolor: isDark ? "#333b45" : "#e3e7ec", zerolinecolor: isDark ? "#55606c" : "#b8c0c9", linecolor: isDark ? "#55606c" : "#b8c0c9" };
    const colours = { "modebar.bgcolor": "rgba(0,0,0,0)", "modebar.color": isDark ? "#77828e" : "#a2abb5", paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", "font.color": isDark ? "#e6e9ee" : "#1c2430" };
    for (const name of ["xaxis", "yaxis"]) for (const key in axis) colours[`${name}.${key}`] = axis[key];
    return colours;
  };
  const paint = (isDark, size) => plots.filter((plot) => plot.layout).forEach((plot) => Plotly.relayout(plot, { ...theme(isDark), ...size }));

  // A zoom of one plot over time applies to all of them.
  let isFollowing = false;
  const follow = (leader, change) => {
    if (isFollowing) return;
    const range = change["xaxis.range"] || (change["xaxis.range[0]"] !== undefined && [change["xaxis.range[0]"], change["xaxis.range[1]"]]);
    if (!range && !change["xaxis.autorange"]) return;
    isFollowing = true;
    const others = plots.filter((plot, at) => plot !== leader && plot.layout && figures[at].is_over_time);
    const update = range ? { "xaxis.range": range.slice() } : { "xaxis.autorange": true };
    Promise.all(others.map((plot) => Plotly.relayout(plot, update))).finally(() => { isFollowing = false; });
  };

  const draw = (at) => {
    if (at === plots.length) {
      document.body.dataset.drawn = at;
      return;
    }
    const { data, layout, is_over_time } = figures[at];
    const axis = (own) => ({ automargin: true, ticks: "outside", exponentformat: "none", ...own, title: { standoff: 8, ...own.title } });
    const whole = {
      margin: { l: 70, r: 15, t: 28, b: 45 }, hovermode: "closest", font: { size: 12 },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.0, yanchor: "bottom" }, dragmode: "zoom",
      ...layout, xaxis: axis(layout.xaxis), yaxis: axis(layout.yaxis),
    };
    // The time axes of all plots are aligned.
    if (is_over_time) { whole.yaxis.automargin = false; whole.margin.l = 150; }
    Plotly.newPlot(plots[at], data, whole, config)
      .then((plot) => Plotly.relayout(plot, theme(dark.matches)))
      .then((plot) => {
        if (is_over_time) plot.on("plotly_relayout", (change) => follow(plot, change));
        setTimeout(draw, 0, at + 1);
      });
  };

  dark.addEventListener("change", () => paint(dark.matches));
  // Paper is white, and narrower than a window: A4 and letter have 700 pixels between their margins.
  addEventListener("beforeprint", () => paint(false, { width: 700 }));
  addEventListener("afterprint", () => paint(dark.matches, { width: null, autosize: true }));
  draw(0);
})();
