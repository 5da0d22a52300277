// Keys of a page. Keys that a part with the focus needs, and those for an open dialog, are left alone.
const TEXT = "input, textarea, select, [contenteditable=true]";
const BUTTON = "button, a, [role=button], [role=tab], [role=switch], [role=checkbox]";

export default {
  template: `<span hidden></span>`,
  props: { keys: Array },
  mounted() {
    this.listener = (event) => this.press(event);
    window.addEventListener("keydown", this.listener);
  },
  unmounted() {
    window.removeEventListener("keydown", this.listener);
  },
  methods: {
    press(event) {
      const { key, target } = event;
      const name = key.length === 1 ? key.toLowerCase() : key;
      if (event.ctrlKey || event.altKey || event.metaKey || !this.keys.includes(name)) return;
      if (target.closest(TEXT) || document.querySelector(".q-dialog, .q-menu")) return;
      if (name === " " && target.closest(BUTTON)) return;
      if (name.startsWith("Arrow") && target.closest("[role=tab]")) return;
      event.preventDefault();
      const over = document.querySelector(".xbus-chart .u-over:hover");
      const plot = over ?? document.querySelector(".xbus-chart .u-over");
      this.$emit("key", {
        key: name,
        shift: event.shiftKey,
        time: over?.xbusTime() ?? null, // below the mouse
        columns: plot?.clientWidth ?? 600, // of pixels
      });
    },
  },
};
