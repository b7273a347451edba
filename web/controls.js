"use strict";
// Mouse, finger and keyboard: each changes the state, and calls ``changed`` for a new picture.

relight.STEP = 0.06; // of the lamp, by an arrow key

// Lamp, pan and zoom on the canvas. page: {state, area(), zoomAt(), changed()}.
relight.pointers = (canvas, page) => {
  const down = new Map(); // pointer → [x, y]
  let pans = false;

  const light = ([x, y]) => {
    const area = page.area(), reach = Math.min(area.width, area.height) / 2;
    page.state.setLamp((x - area.x) / reach, (area.y - y) / reach);
    page.changed();
  };
  const move = (dx, dy) => {
    page.settleZoom();
    page.state.x -= dx / page.state.zoom;
    page.state.y -= dy / page.state.zoom;
    page.changed();
  };
  const gauge = () => {
    const [[ax, ay], [bx, by]] = [...down.values()];
    return { x: (ax + bx) / 2, y: (ay + by) / 2, apart: Math.hypot(ax - bx, ay - by) };
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, [event.clientX, event.clientY]);
    pans = event.button > 0 || event.shiftKey || page.state.comparing;
    if (!pans && down.size === 1) light([event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const former = down.get(event.pointerId), now = [event.clientX, event.clientY];
    if (!former) return;
    if (down.size === 2) {
      const before = gauge();
      down.set(event.pointerId, now);
      const after = gauge();
      move(after.x - before.x, after.y - before.y);
      page.zoomAt(after.apart / Math.max(before.apart, 1), after.x, after.y);
      return;
    }
    down.set(event.pointerId, now);
    if (pans) move(now[0] - former[0], now[1] - former[1]);
    else if (down.size === 1) light(now);
  });
  const up = (event) => {
    down.delete(event.pointerId);
    pans = true; // the finger that stays does not seize the lamp
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode ? 30 : 1;
    page.zoomAt(2 ** (-event.deltaY * lines / 240), event.clientX, event.clientY);
  }, { passive: false });
};

// The disc of directions: drags the lamp; a click on a mark shows that photograph.
relight.dial = (dial, page) => {
  const move = (event) => {
    if (!event.buttons) return;
    const box = dial.getBoundingClientRect(), reach = (box.width / 2) / 1.15;
    page.state.setLamp((event.clientX - box.x - box.width / 2) / reach, (box.y + box.height / 2 - event.clientY) / reach);
    page.changed();
  };
  dial.addEventListener("pointerdown", (event) => {
    const mark = event.target.dataset.index;
    if (mark !== undefined) {
      page.state.compare(Number(mark));
      page.changed();
      return;
    }
    dial.setPointerCapture(event.pointerId);
    move(event);
  });
  dial.addEventListener("pointermove", (event) => dial.hasPointerCapture(event.pointerId) && move(event));
};

// The border between photograph and render.
relight.divider = (divider, page) => {
  const put = (share) => {
    page.state.split = Math.max(0, Math.min(1, share));
    page.changed();
  };
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => event.buttons && put(event.clientX / window.innerWidth));
  divider.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, ArrowDown: -0.02, Home: -1, End: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    put(page.state.split + by);
  });
};

// Keys, wherever the focus is, but in fields that use them themselves.
relight.keyboard = (page) => {
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  const { state } = page;
  const keys = {
    u: () => state.setUncertain(!state.uncertain),
    p: () => (state.comparing ? (state.comparing = false) : state.compare(state.photograph)),
    ",": () => state.compare(state.photograph - 1),
    ".": () => state.compare(state.photograph + 1),
    "[": () => state.setExposure(state.exposure - 0.25),
    "]": () => state.setExposure(state.exposure + 0.25),
    "+": () => page.zoomAt(1.25),
    "=": () => page.zoomAt(1.25),
    "-": () => page.zoomAt(0.8),
    f: () => page.fit(),
    o: () => page.zoomTo(1 / Math.min(window.devicePixelRatio || 1, 2)),
    h: () => (state.bare = !state.bare),
    "?": () => page.help(),
  };
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const arrow = arrows[event.key];
    if (arrow && event.target.type === "range") return;
    if (arrow && event.shiftKey) {
      page.settleZoom();
      state.x += (60 * arrow[0]) / state.zoom;
      state.y -= (60 * arrow[1]) / state.zoom;
    } else if (arrow) {
      state.setLamp(state.lamp.u + relight.STEP * arrow[0], state.lamp.v + relight.STEP * arrow[1]);
    } else if (/^[1-9]$/.test(event.key)) {
      state.setMap(Number(event.key) - 1);
    } else {
      const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      action();
    }
    event.preventDefault();
    page.changed();
  });
};
