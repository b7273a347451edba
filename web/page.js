"use strict";
// The page: joins state, stage and controls, and keeps buttons, labels and the address up to date.

const part = (id) => document.getElementById(id);

relight.fault = (text) => {
  part("fault").textContent = text;
  part("fault").hidden = false;
};

relight.Page = class {
  constructor(result) {
    this.result = result;
    this.state = new relight.State(result);
    this.state.read(location.hash);
    this.frame = 0;
    this.stage = new relight.Stage(part("stage"), result, () => this.changed());
    this.furnish();
    relight.pointers(part("stage"), this);
    relight.dial(part("dial"), this);
    relight.divider(part("divider"), this);
    relight.keyboard(this);
    this.onButtons();
    window.addEventListener("resize", () => this.changed());
    window.addEventListener("hashchange", () => {
      if (location.hash === this.written) return;
      const bare = this.state.bare;
      Object.assign(this.state, new relight.State(result));
      this.state.read(location.hash);
      this.state.bare ||= bare && !location.hash;
      this.changed();
    });
    part("stage").addEventListener("webglcontextlost", () => relight.fault("The graphics card has dropped the picture. Load the page again."));
    this.changed();
  }

  // Words, buttons and marks that follow from the result.
  furnish() {
    const { result } = this, photographs = result.photographs;
    document.title = `${result.name} – relit`;
    part("name").textContent = result.name;
    part("about").textContent = `${result.size[0]} × ${result.size[1]} texels. ${result.model}. Made with IRPSO.`;
    part("ramp").style.background = `linear-gradient(to right, ${result.ramp.map((c) => `rgb(${c.map((x) => 255 * x)})`)})`;
    this.state.titles.forEach((title, index) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = title;
      button.title = `${title} (${index + 1})`;
      button.setAttribute("aria-keyshortcuts", index + 1);
      button.addEventListener("click", () => this.act(() => this.state.setMap(index)));
      part("maps").append(button);
    });
    part("lights").hidden = !photographs.length;
    part("uncertain").hidden = !result.uncertaintyPlanes;
    photographs.forEach((taken, index) => {
      const mark = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      const [x, y] = this.direction(taken.light);
      for (const [name, value] of Object.entries({ cx: x, cy: -y, r: 0.07 })) mark.setAttribute(name, value);
      mark.dataset.index = index;
      part("marks").append(mark);
    });
  }

  // The unit direction to a light, from the middle of the card if it is near.
  direction([x, y, z, near]) {
    const [corner, across, down] = this.result.place, [width, height] = this.result.size;
    const d = [x, y, z].map((c, i) => c - near * (corner[i] + (width * across[i] + height * down[i]) / 2));
    return d.map((c) => c / Math.hypot(...d));
  }

  onButtons() {
    const state = this.state, on = (id, action) => part(id).addEventListener("click", () => this.act(action));
    on("uncertain", () => state.setUncertain(!state.uncertain));
    on("photograph", () => (state.comparing ? (state.comparing = false) : state.compare(state.photograph)));
    on("former", () => state.compare(state.photograph - 1));
    on("next", () => state.compare(state.photograph + 1));
    on("in", () => this.zoomAt(1.25));
    on("out", () => this.zoomAt(0.8));
    on("fit", () => this.fit());
    on("help", () => this.help());
    part("exposure").addEventListener("input", (event) => this.act(() => state.setExposure(Number(event.target.value))));
  }

  act(action) {
    action();
    this.changed();
  }

  help() {
    part("keys").showModal();
  }

  // The free part of the window: its middle and size, in CSS pixels.
  area() {
    const width = window.innerWidth;
    if (this.state.bare) return { x: width / 2, y: window.innerHeight / 2, width, height: window.innerHeight };
    const top = window.innerHeight <= 480 ? 10 : 56, height = Math.max(part("panel").getBoundingClientRect().top - 12 - top, 80);
    return { x: width / 2, y: top + height / 2, width, height };
  }

  get fitting() {
    const area = this.area(), [width, height] = this.result.size, margin = this.state.bare ? 0 : 24;
    return Math.min((area.width - margin) / width, area.height / height);
  }

  // A zoom that follows the window becomes a number.
  settleZoom() {
    if (!this.state.zoom) this.state.zoom = this.fitting;
  }

  fit() {
    this.state.zoom = 0;
    [this.state.x, this.state.y] = this.result.size.map((side) => side / 2);
  }

  zoomTo(zoom) {
    this.settleZoom();
    this.zoomAt(zoom / this.state.zoom);
  }

  // Zooms by a factor; the texel at a place of the window stays there.
  zoomAt(factor, x, y) {
    this.settleZoom();
    const { state } = this, area = this.area(), [least, most] = relight.State.ZOOMS;
    const zoom = Math.max(least, Math.min(most, state.zoom * factor));
    const by = 1 / state.zoom - 1 / zoom;
    state.x += ((x ?? area.x) - area.x) * by;
    state.y += ((y ?? area.y) - area.y) * by;
    state.zoom = zoom;
    this.changed();
  }

  changed() {
    document.documentElement.dataset.ready = "no";
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      this.draw();
    });
  }

  draw() {
    const { state } = this;
    document.body.classList.toggle("bare", state.bare);
    document.body.classList.toggle("comparing", state.comparing);
    const fitted = !state.zoom;
    const [width, height] = this.result.size;
    state.x = Math.max(0, Math.min(width, state.x));
    state.y = Math.max(0, Math.min(height, state.y));
    this.label();
    const whole = this.stage.draw(fitted ? { ...state, zoom: this.fitting } : state, this.area());
    this.written = state.write(fitted);
    history.replaceState(null, "", this.written);
    document.documentElement.dataset.ready = whole && !this.frame ? "yes" : "no";
  }

  // Buttons, marks and words after the state.
  label() {
    const { state, result } = this, taken = result.photographs[state.photograph];
    const press = (button, on) => button.setAttribute("aria-pressed", on);
    [...part("maps").children].forEach((button, index) => press(button, index === state.map));
    if (this.shown !== state.map) part("maps").children[state.map].scrollIntoView({ block: "nearest", inline: "nearest" });
    this.shown = state.map;
    press(part("uncertain"), state.uncertain);
    part("uncertain").disabled = !state.canDoubt;
    press(part("photograph"), state.comparing);
    if (taken) part("photograph").textContent = state.comparing ? `Photograph ${state.photograph + 1} / ${result.photographs.length}` : "Photograph";
    part("exposure").value = state.exposure;
    part("exposure").disabled = Boolean(state.map || state.uncertain);
    part("exposure").setAttribute("aria-valuetext", `${state.exposure} stops`);
    this.placeDivider();
    const [u, v] = state.comparing ? this.direction(taken.light) : [state.lamp.u, state.lamp.v];
    part("lamp").setAttribute("cx", u);
    part("lamp").setAttribute("cy", -v);
    [...part("marks").children].forEach((mark, index) => mark.classList.toggle("chosen", state.comparing && index === state.photograph));
    const shown = result.parameters[state.map - 1], single = shown && shown.uncertainty && (state.uncertain || !shown.place);
    part("legend").hidden = !(state.uncertain || single);
    part("most").textContent = single ? `${shown.uncertainty[1]}${shown.place ? " and more" : ""}` : "unknown";
    this.placeDial();
    this.say(this.words(u, v, taken));
  }

  // Beside the panel, or above it where there is no room.
  placeDial() {
    const panel = part("panel").getBoundingClientRect(), dial = part("dial");
    const beside = panel.right + dial.clientWidth + 24 <= window.innerWidth;
    dial.style.bottom = beside ? "" : `${window.innerHeight - panel.top + 8}px`;
  }

  // As high as the picture, in the window.
  placeDivider() {
    const { state } = this, divider = part("divider"), area = this.area(), zoom = state.zoom || this.fitting;
    const top = Math.max(0, area.y - state.y * zoom);
    const lower = Math.min(area.y + area.height / 2 + 12, area.y + (this.result.size[1] - state.y) * zoom);
    divider.hidden = !state.comparing;
    Object.assign(divider.style, { left: `${100 * state.split}%`, top: `${top}px`, height: `${Math.max(lower - top, 40)}px` });
    divider.setAttribute("aria-valuenow", Math.round(100 * state.split));
    divider.setAttribute("aria-valuetext", `${Math.round(100 * state.split)} % photograph`);
  }

  words(u, v, taken) {
    const { state } = this;
    if (state.uncertain) return `${state.map ? state.titles[state.map] : "Largest"} uncertainty: one standard deviation`;
    if (state.map) return state.titles[state.map] === "Residual" ? "Mean difference between render and photographs, of white" : `${state.titles[state.map]} map`;
    const height = Math.round((Math.acos(Math.min(1, Math.hypot(u, v))) * 180) / Math.PI);
    const sides = [v > 0.17 ? "top" : v < -0.17 ? "bottom" : "", u > 0.17 ? "right" : u < -0.17 ? "left" : ""].filter(Boolean);
    const where = `light ${height}° above the surface${sides.length ? `, from the ${sides.join(" ")}` : ""}`;
    if (!state.comparing) return where[0].toUpperCase() + where.slice(1);
    return `${taken.name}${taken.unseen ? ", which the recovery has not seen" : ""}: ${where}`;
  }

  say(text) {
    if (part("said").textContent !== text) part("said").textContent = text;
  }
};

try {
  relight.page = new relight.Page(relight.result);
} catch (fault) {
  relight.fault(fault.message);
  document.documentElement.dataset.ready = "fault";
  throw fault;
}
