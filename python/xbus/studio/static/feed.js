// The feed of live curves, shared by all charts of a page. See feed.py for the messages.
window.xbusFeed = (() => {
  const curves = new Map(); // id -> {request, receive}
  let socket = null;
  let nextId = 1;
  let retry = 250; // ms until the next attempt to connect

  function connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/feed`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      retry = 250;
      for (const { request } of curves.values()) socket.send(JSON.stringify({ show: request }));
    };
    socket.onmessage = ({ data }) => {
      const head = new Uint32Array(data, 0, 4);
      const [id, n, k, final] = head;
      const time = new Float64Array(data, 16, n);
      const values = [];
      for (let row = 0; row < k; row++) values.push(new Float64Array(data, 16 + 8 * n * (row + 1), n));
      curves.get(id)?.receive({ time, values, final: final !== 0 });
    };
    socket.onclose = () => {
      socket = null;
      if (curves.size === 0) return;
      setTimeout(() => socket ?? connect(), retry);
      retry = Math.min(2 * retry, 5000);
    };
  }

  function send(message) {
    if (socket === null) connect();
    else if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }

  return {
    // Shows a curve; receive gets {time, values, final}. After a lost connection the curve begins again.
    show(request, receive) {
      const id = nextId++;
      curves.set(id, { request: { ...request, id }, receive });
      send({ show: { ...request, id } });
      return id;
    },
    hide(id) {
      if (curves.delete(id)) send({ hide: id });
    },
  };
})();
