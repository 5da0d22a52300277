// An artificial horizon with heading and bank, drawn from the curve "attitude" of the feed.
const VIEW = 60; // degrees from the lower to the upper edge
const STALE = 2; // seconds without an attitude until it is dashes

export default {
  template: `<canvas class="xbus-horizon" role="img" :aria-label="text"></canvas>`,
  props: { source: String, ended: Boolean },
  data: () => ({ text: "no attitude" }),
  mounted() {
    this.attitude = null;
    this.arrived = 0;
    const request = { source: this.source, name: "attitude", step: 0.001, span: 1 };
    this.curve = window.xbusFeed.show(request, ({ time, values }) => {
      if (!time.length) return;
      this.attitude = values.map((row) => row[row.length - 1]);
      this.arrived = performance.now();
    });
    const frame = () => {
      this.request = requestAnimationFrame(frame);
      this.draw();
    };
    frame();
  },
  unmounted() {
    cancelAnimationFrame(this.request);
    window.xbusFeed.hide(this.curve);
  },
  methods: {
    draw() {
      const canvas = this.$el;
      const ratio = devicePixelRatio;
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) return;
      const isStale = this.attitude === null || (!this.ended && performance.now() - this.arrived > 1000 * STALE);
      const shown = [this.attitude, isStale, width, height, ratio];
      if (shown.every((part, i) => part === this.shown?.[i])) return;
      this.shown = shown;
      if (canvas.width !== width * ratio || canvas.height !== height * ratio) {
        canvas.width = width * ratio;
        canvas.height = height * ratio;
      }
      const g = canvas.getContext("2d");
      g.setTransform(ratio, 0, 0, ratio, 0, 0);
      g.clearRect(0, 0, width, height);
      if (isStale) {
        g.fillStyle = "#777";
        g.fillRect(0, 0, width, height);
        g.fillStyle = "#fff";
        g.textAlign = "center";
        g.font = "14px system-ui";
        g.fillText(this.attitude === null ? "no attitude" : "attitude has stopped", width / 2, height / 2);
        this.text = "no attitude";
        return;
      }
      const [heading, pitch, roll] = this.attitude;
      const scale = height / VIEW;
      g.save();
      g.translate(width / 2, height / 2);
      g.rotate((-roll * Math.PI) / 180);
      g.translate(0, pitch * scale);
      const far = 4 * (width + height);
      g.fillStyle = "#3b7dd8";
      g.fillRect(-far, -far, 2 * far, far);
      g.fillStyle = "#8a5a2b";
      g.fillRect(-far, 0, 2 * far, far);
      g.strokeStyle = g.fillStyle = "#fff";
      g.lineWidth = 1.5;
      g.font = "11px system-ui";
      g.textAlign = "left";
      g.textBaseline = "middle";
      g.beginPath();
      g.moveTo(-far, 0);
      g.lineTo(far, 0);
      for (let mark = -90; mark <= 90; mark += 5) {
        if (mark === 0 || Math.abs(mark + 0 - pitch) > VIEW / 2) continue;
        const half = mark % 10 === 0 ? 28 : 14;
        g.moveTo(-half, -mark * scale);
        g.lineTo(half, -mark * scale);
        if (mark % 10 === 0) g.fillText(String(mark), half + 5, -mark * scale);
      }
      g.stroke();
      g.restore();
      // The device, which does not move.
      g.strokeStyle = "#ffd400";
      g.lineWidth = 3;
      g.beginPath();
      g.moveTo(width / 2 - 46, height / 2);
      g.lineTo(width / 2 - 16, height / 2);
      g.lineTo(width / 2, height / 2 + 9);
      g.lineTo(width / 2 + 16, height / 2);
      g.lineTo(width / 2 + 46, height / 2);
      g.stroke();
      // The bank scale: its pointer moves.
      const radius = 0.42 * height;
      g.save();
      g.translate(width / 2, height / 2);
      g.strokeStyle = g.fillStyle = "#fff";
      g.lineWidth = 2;
      for (const mark of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
        g.save();
        g.rotate((mark * Math.PI) / 180);
        g.beginPath();
        g.moveTo(0, -radius);
        g.lineTo(0, -radius - (mark % 30 === 0 ? 10 : 6));
        g.stroke();
        g.restore();
      }
      g.rotate((-roll * Math.PI) / 180);
      g.beginPath();
      g.moveTo(0, -radius + 2);
      g.lineTo(-6, -radius + 13);
      g.lineTo(6, -radius + 13);
      g.fill();
      g.restore();
      // The compass strip.
      g.fillStyle = "rgba(0,0,0,.55)";
      g.fillRect(0, height - 30, width, 30);
      g.fillStyle = "#fff";
      g.textAlign = "center";
      const names = { 0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW" };
      for (let mark = Math.floor(heading / 15) * 15 - 60; mark <= heading + 75; mark += 15) {
        const x = width / 2 + ((mark - heading) * width) / 120;
        const name = names[((mark % 360) + 360) % 360];
        if (name) g.fillText(name, x, height - 12);
        else g.fillRect(x - 0.5, height - 20, 1, 8);
      }
      g.fillStyle = "#ffd400";
      g.fillRect(width / 2 - 1, height - 30, 2, 7);
      const round = (angle) => Math.round(angle * 10) / 10 + 0;
      this.text = `heading ${Math.round(heading) % 360}°, pitch ${round(pitch)}°, roll ${round(roll)}°`;
    },
  },
};
