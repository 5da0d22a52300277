// A chart of one series over time: live, paused, or zoomed.
const LIGHT = ["#D55E00", "#009E73", "#0072B2", "#CC79A7", "#8a6d00", "#444444"];
const DARK = ["#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#F0E442", "#cccccc"];
const DASHES = [[], [8, 3], [2, 3], [8, 3, 2, 3], [12, 3], [4, 6]];
const FRAME = 33; // ms between two frames
const AXIS = 80; // px beside the curves

import { clock } from "/static/clock.js";

// Decimals that show a ten-thousandth of the axis.
function decimals({ min, max }) {
  return max > min ? Math.min(12, Math.max(0, Math.ceil(4 - Math.log10(max - min)))) : 3;
}

export default {
  template: `<div class="xbus-chart"><div ref="plot"></div></div>`,
  props: {
    source: String,
    name: String, // of the series
    label: String,
    fields: Array,
    span: Number,
    view: Array,
    held: Number, // number of the samples that a paused plot shows
    locked: Boolean,
    limits: Array, // of the y axis that is locked, if they are known
    elapsed: Boolean, // whether times are those of a recording
    speed: Number, // with which live curves move on
    cursors: Object, // times of A and B
    active: String, // the one that moves
  },
  mounted() {
    this.time = [];
    this.values = this.fields.map(() => []);
    this.last = 0; // time of the point from which the clock of the chart runs
    this.lastAt = 0; // when it arrived, in ms
    this.fixed = this.locked ? this.limits : null; // limits of the y axis
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.$el);
    this.darkness = new MutationObserver(() => this.build());
    this.darkness.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.build();
    this.ask();
    const frame = (now) => {
      this.request = requestAnimationFrame(frame);
      if (now - (this.drawn ?? 0) >= FRAME - 4 && !this.view) {
        this.drawn = now;
        this.draw();
      }
    };
    this.request = requestAnimationFrame(frame);
  },
  unmounted() {
    cancelAnimationFrame(this.request);
    this.observer.disconnect();
    this.darkness.disconnect();
    window.xbusFeed.hide(this.curve);
    this.plot?.destroy();
  },
  watch: {
    view(view, before) {
      if (String(view) !== String(before)) this.ask(); // any change of the page sends an equal one again
    },
    span() {
      if (!this.view) this.show();
    },
    locked() {
      this.fixed = null;
      this.lock();
      this.draw();
    },
    speed() {
      if (this.time.length) this.follow(this.time[this.time.length - 1]);
    },
    cursors() {
      this.plot.redraw(false, false);
    },
    active() {
      this.plot.redraw(false, false);
    },
  },
  methods: {
    // Columns of pixels; uPlot knows the exact number only after it has drawn.
    columns() {
      return Math.max(50, this.plot.width - AXIS);
    },
    ask() {
      if (this.view) this.freeze(...this.view);
      else this.show();
    },
    now() {
      return this.last + Math.min(2 * this.span, (this.speed * (performance.now() - this.lastAt)) / 1000);
    },
    // Lets the clock of the chart run from a point that has arrived now.
    follow(time) {
      this.last = time;
      this.lastAt = performance.now();
    },
    // Keeps the present limits of the y axis, once there are some.
    lock() {
      const { min, max } = this.plot.scales.y;
      if (!this.locked || this.fixed || !this.time.length || min == null) return;
      this.fixed = [min, max];
      this.$emit("lock", { min, max });
    },
    // Asks for the past and for what comes.
    show() {
      window.xbusFeed.hide(this.curve);
      this.clear();
      this.asked = this.columns();
      const request = { source: this.source, name: this.name, step: this.span / this.asked, span: this.span };
      this.curve = window.xbusFeed.show(request, (points) => this.add(points));
    },
    // Asks for a part of the past, with all its detail.
    freeze(begin, end) {
      window.xbusFeed.hide(this.curve);
      this.asked = this.columns();
      const { source, name, held } = this;
      const request = { source, name, held: held ?? null, step: (end - begin) / this.asked, begin, end };
      this.curve = window.xbusFeed.show(request, (points) => {
        this.clear();
        this.append(points);
        this.draw();
      });
      this.draw(); // a click meets the new axis, even before its points have arrived
    },
    clear() {
      this.time = [];
      this.values = this.fields.map(() => []);
      this.legendAt = null; // what the legend shows is gone too: the next points set it at once
    },
    append({ time, values }) {
      for (let i = 0; i < time.length; i++) this.time.push(time[i]);
      values.forEach((row, k) => {
        const target = this.values[k];
        for (let i = 0; i < row.length; i++) target.push(Number.isNaN(row[i]) ? null : row[i]);
      });
    },
    add(points) {
      const before = this.time.length;
      if (before && points.time.length && points.time[0] <= this.time[before - 1]) this.clear();
      this.append(points);
      if (!this.time.length) return;
      const last = this.time[this.time.length - 1];
      // The clock of the chart never runs back, although messages are not evenly spaced.
      if (last > this.now() || last < this.now() - Math.max(1, this.speed)) {
        this.follow(last);
      }
      const old = this.time.findIndex((t) => t >= last - 1.2 * this.span);
      if (old > 0.2 * this.time.length) {
        this.time.splice(0, old);
        this.values.forEach((row) => row.splice(0, old));
      }
    },
    draw() {
      if (!this.plot) return;
      const [min, max] = this.view ?? [this.now() - this.span, this.now()];
      if (!(max > min)) return;
      this.plot.batch(() => {
        this.plot.setData([this.time, ...this.values], false);
        this.plot.setScale("x", { min, max });
      });
      // Without a mouse over the plots, the legend has the latest values, slowly enough to read them.
      if (this.plot.cursor.left < 0 && performance.now() - (this.legendAt ?? 0) > 200) {
        this.legendAt = performance.now();
        this.plot.setLegend({ idx: this.time.length ? this.time.length - 1 : null });
      }
    },
    // Draws the cursors A and B, and tints the time between them.
    mark(plot) {
      const { ctx: g, bbox } = plot;
      const places = Object.entries(this.cursors ?? {}).map(([name, t]) => [name, plot.valToPos(t, "x", true)]);
      if (!this.view || !places.length) return;
      g.save();
      g.beginPath();
      g.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      g.clip();
      g.fillStyle = this.isDark ? "rgba(255,255,255,.07)" : "rgba(0,0,0,.05)";
      if (places.length === 2) g.fillRect(places[0][1], bbox.top, places[1][1] - places[0][1], bbox.height);
      g.fillStyle = g.strokeStyle = this.isDark ? "#fff" : "#000";
      g.setLineDash([]);
      g.font = `600 ${12 * devicePixelRatio}px system-ui`;
      g.textBaseline = "top";
      for (const [name, x] of places) {
        g.lineWidth = (name === this.active ? 2 : 1) * devicePixelRatio;
        g.beginPath();
        g.moveTo(x, bbox.top);
        g.lineTo(x, bbox.top + bbox.height);
        g.stroke();
        g.textAlign = x > bbox.left + bbox.width - 20 * devicePixelRatio ? "right" : "left";
        g.fillText(name, x + (g.textAlign === "left" ? 4 : -4) * devicePixelRatio, bbox.top + 2 * devicePixelRatio);
      }
      g.restore();
    },
    // The last point at a time or before it; null before the first.
    pointAt(time) {
      let low = 0, high = this.time.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.time[middle] <= time) low = middle + 1;
        else high = middle;
      }
      return low ? low - 1 : null;
    },
    resize() {
      const width = this.$el.clientWidth;
      if (!width || !this.plot) return;
      this.plot.setSize({ width, height: this.height() });
      const change = this.columns() / this.asked;
      if (change < 0.8 || change > 1.25) this.ask();
    },
    height() {
      return 190;
    },
    build() {
      const dark = document.body.classList.contains("body--dark");
      if (this.plot && dark === this.isDark) return;
      this.isDark = dark;
      this.plot?.destroy();
      const colors = dark ? DARK : LIGHT;
      const ink = dark ? "#c8c8c8" : "#444";
      const grid = { stroke: dark ? "#333" : "#e4e4e4", width: 1 };
      const axis = { stroke: ink, grid, ticks: grid };
      const chart = this;
      const local = (time) => clock(time, chart.elapsed);
      this.plot = new uPlot(
        {
          width: this.$el.clientWidth || 600,
          height: this.height(),
          title: this.label,
          cursor: {
            drag: { x: true, y: false },
            sync: { key: "xbus" },
            dataIdx: (_plot, _series, _nearest, time) => chart.pointAt(time),
            bind: { dblclick: () => null }, // it would change the time of this chart only
          },
          legend: { live: true },
          scales: {
            x: { time: true },
            y: {
              range: (_, min, max) => {
                if (chart.fixed) return chart.fixed;
                if (min == null) return [0, 1];
                const margin = 0.08 * (max - min) || 0.5 * Math.max(Math.abs(max), 1e-3);
                return [min - margin, max + margin];
              },
            },
          },
          axes: [
            {
              ...axis,
              space: 64,
              values: (_, times, column, space, step) => times.map((t) => local(t).slice(0, step < 1 ? 12 : 8)),
            },
            { ...axis, size: 64 },
          ],
          series: [
            { label: "time", value: (_, t) => (t == null ? "--" : local(t)) },
            ...this.fields.map((field, k) => ({
              label: field,
              stroke: colors[k % colors.length],
              width: 1.5 / devicePixelRatio + 0.5,
              dash: DASHES[k % DASHES.length].map((d) => d),
              points: { show: false },
              value: (plot, v) => (v == null ? "--" : v.toFixed(decimals(plot.scales.y))),
            })),
          ],
          hooks: {
            draw: [(plot) => chart.mark(plot), () => chart.lock()],
            setSelect: [
              (plot) => {
                if (plot.select.width < 5) return;
                const begin = plot.posToVal(plot.select.left, "x");
                const end = plot.posToVal(plot.select.left + plot.select.width, "x");
                plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
                chart.$emit("zoom", { begin, end });
              },
            ],
          },
        },
        [[], ...this.fields.map(() => [])],
        this.$refs.plot
      );
      const { over } = this.plot;
      // For keys: the time below the mouse.
      over.xbusTime = () => this.plot.posToVal(this.plot.cursor.left, "x");
      over.addEventListener("click", (event) => {
        if (this.view) this.$emit("place", { time: this.plot.posToVal(event.offsetX, "x") });
      });
      this.draw();
    },
  },
};
