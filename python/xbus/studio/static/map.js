// The track of a device on a plane: metres east and north of its first position. It needs no tiles.
const POINTS = 1000; // columns of the track
const MARGIN = 26; // px around the track
const LEAST = 5; // m from the middle to an edge, at least

// The longest of 1, 2 or 5 times a power of ten that is not above a length.
function rounded(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return [5, 2, 1].map((factor) => factor * power).find((size) => size <= length) ?? power;
}

function metres(length) {
  return length >= 1000 ? `${length / 1000} km` : length >= 1 ? `${length} m` : `${Math.round(1000 * length)} mm`;
}

export default {
  template: `<canvas class="xbus-map" role="img" :aria-label="label"></canvas>`,
  props: {
    source: String,
    name: String, // of the series
    span: Number,
    accuracy: Number, // m, or null
    stale: Boolean,
    marks: Object, // east and north of the cursors
    label: String,
  },
  mounted() {
    this.darkness = new MutationObserver(() => this.draw());
    this.darkness.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.$el);
    const latest = { source: this.source, name: this.name, step: 0.2, span: 1 };
    this.now = window.xbusFeed.show(latest, ({ time, values }) => {
      for (let i = time.length - 1; i >= 0; i--) {
        if (Number.isNaN(values[0][i])) continue;
        this.place = [values[0][i], values[1][i]];
        break;
      }
      this.draw();
    });
    this.show();
  },
  unmounted() {
    this.darkness.disconnect();
    this.observer.disconnect();
    window.xbusFeed.hide(this.now);
    window.xbusFeed.hide(this.curve);
  },
  watch: {
    span() {
      this.show();
    },
    accuracy: "draw",
    stale: "draw",
    marks: "draw",
  },
  methods: {
    show() {
      if (this.curve) window.xbusFeed.hide(this.curve);
      this.points = []; // [time, east, north]; NaN is a gap
      const request = { source: this.source, name: this.name, step: this.span / POINTS, span: this.span };
      this.curve = window.xbusFeed.show(request, ({ time, values }) => {
        const last = this.points[this.points.length - 1];
        if (last && time.length && time[0] <= last[0]) this.points = [];
        for (let i = 0; i < time.length; i++) this.points.push([time[i], values[0][i], values[1][i]]);
        const end = time[time.length - 1];
        const old = this.points.findIndex(([at]) => at >= end - this.span);
        if (old > 0) this.points.splice(0, old);
        this.draw();
      });
    },
    // The middle, and the metres to the nearest edge.
    bounds() {
      const known = this.points.filter(([, east]) => !Number.isNaN(east)).map(([, ...place]) => place);
      if (this.place) {
        const radius = this.accuracy ?? 0;
        for (const sign of [-1, 1]) known.push(this.place.map((axis) => axis + sign * radius));
      }
      if (!known.length) return null;
      const [low, high] = [Infinity, -Infinity].map((start, k) =>
        [0, 1].map((axis) => known.reduce((so, place) => (k ? Math.max : Math.min)(so, place[axis]), start))
      );
      return { middle: [0, 1].map((axis) => (low[axis] + high[axis]) / 2), half: [0, 1].map((axis) => (high[axis] - low[axis]) / 2) };
    },
    draw() {
      const canvas = this.$el;
      const ratio = devicePixelRatio;
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) return;
      canvas.width = width * ratio;
      canvas.height = height * ratio;
      const g = canvas.getContext("2d");
      g.setTransform(ratio, 0, 0, ratio, 0, 0);
      const dark = document.body.classList.contains("body--dark");
      const ink = dark ? "#d0d0d0" : "#333", line = dark ? "#56B4E9" : "#0072B2";
      g.fillStyle = g.strokeStyle = ink;
      g.font = "12px system-ui";
      const bounds = this.bounds();
      if (bounds === null) {
        g.textAlign = "center";
        g.fillText("no position with a fix", width / 2, height / 2);
        return;
      }
      const scale = Math.min(
        (width / 2 - MARGIN) / Math.max(bounds.half[0], LEAST),
        (height / 2 - MARGIN) / Math.max(bounds.half[1], LEAST)
      );
      const x = (east) => width / 2 + (east - bounds.middle[0]) * scale;
      const y = (north) => height / 2 - (north - bounds.middle[1]) * scale;
      this.drawGrid(g, width, height, scale, x, y, dark);
      g.strokeStyle = line;
      g.lineWidth = 2;
      g.lineJoin = "round";
      g.beginPath();
      let isDrawn = false;
      for (const [, east, north] of [...this.points, ...(this.place && !this.stale ? [[0, ...this.place]] : [])]) {
        if (Number.isNaN(east)) isDrawn = false;
        else {
          if (isDrawn) g.lineTo(x(east), y(north));
          else g.moveTo(x(east), y(north));
          isDrawn = true;
        }
      }
      g.stroke();
      if (this.place) this.drawPlace(g, x(this.place[0]), y(this.place[1]), scale, line);
      g.fillStyle = g.strokeStyle = dark ? "#fff" : "#000";
      g.font = "600 12px system-ui";
      g.textAlign = "left";
      for (const [name, [east, north]] of Object.entries(this.marks ?? {})) {
        g.fillRect(x(east) - 3, y(north) - 3, 6, 6);
        g.fillText(name, x(east) + 6, y(north) - 6);
      }
    },
    // Where the device is, and how accurately that is known.
    drawPlace(g, x, y, scale, color) {
      g.globalAlpha = this.stale ? 0.4 : 1;
      g.fillStyle = g.strokeStyle = color;
      if (this.accuracy) {
        g.beginPath();
        g.arc(x, y, this.accuracy * scale, 0, 2 * Math.PI);
        g.lineWidth = 1;
        g.stroke();
        g.globalAlpha *= 0.15;
        g.fill();
        g.globalAlpha = this.stale ? 0.4 : 1;
      }
      g.beginPath();
      g.arc(x, y, 5, 0, 2 * Math.PI);
      if (this.stale) g.stroke();
      else g.fill();
      g.globalAlpha = 1;
    },
    // Lines at the length of the scale bar, the bar, and the north arrow.
    drawGrid(g, width, height, scale, x, y, dark) {
      const size = rounded(width / 4 / scale);
      g.strokeStyle = dark ? "#2c3035" : "#e4e6e9";
      g.lineWidth = 1;
      g.beginPath();
      for (let at = x(0) % (size * scale); at < width; at += size * scale) g.moveTo(at, 0), g.lineTo(at, height);
      for (let at = y(0) % (size * scale); at < height; at += size * scale) g.moveTo(0, at), g.lineTo(width, at);
      g.stroke();
      g.strokeStyle = g.fillStyle = dark ? "#d0d0d0" : "#333";
      g.lineWidth = 2;
      const right = width - 10, bottom = height - 10, left = right - size * scale;
      g.beginPath();
      g.moveTo(left, bottom - 5);
      g.lineTo(left, bottom);
      g.lineTo(right, bottom);
      g.lineTo(right, bottom - 5);
      g.stroke();
      g.textAlign = "center";
      g.fillText(metres(size), (left + right) / 2, bottom - 6);
      g.beginPath();
      g.moveTo(right - 8, 8);
      g.lineTo(right - 2, 26);
      g.lineTo(right - 8, 22);
      g.lineTo(right - 14, 26);
      g.fill();
      g.fillText("N", right - 8, 40);
    },
  },
};
