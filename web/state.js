"use strict";
// What the page shows, as an object and as the part of the address after #, so that a link opens what its sender saw.

relight.State = class {
  static STEEPEST = 0.985; // radius of the lamp in the disc of directions, 10° above the surface
  static ZOOMS = [1 / 64, 32]; // screen pixels a texel

  constructor(result) {
    this.result = result;
    this.lamp = { u: -0.45, v: 0.5 }; // the direction's x and y
    this.map = 0; // 0: relit; then the maps
    this.uncertain = false;
    this.comparing = false;
    this.photograph = 0;
    this.split = 0.5;
    this.exposure = 0;
    this.zoom = 0; // 0: all of it
    [this.x, this.y] = result.size.map((side) => side / 2); // the texel in the middle
    this.bare = false;
  }

  // The titles of what can be shown.
  get titles() {
    return ["Relit", ...this.result.parameters.map((p) => p.title)];
  }

  // Whether what is shown has an uncertainty to switch on; the residual is one itself.
  get canDoubt() {
    const shown = this.result.parameters[this.map - 1];
    return shown ? Boolean(shown.place && shown.uncertainty) : this.result.parameters.some((p) => p.place && p.uncertainty);
  }

  setLamp(u, v) {
    const scale = Math.min(1, relight.State.STEEPEST / (Math.hypot(u, v) || 1));
    this.lamp = { u: u * scale, v: v * scale };
    this.comparing = false;
  }

  setMap(index) {
    if (index < 0 || index >= this.titles.length) return;
    this.map = index;
    this.uncertain = this.uncertain && this.canDoubt;
    if (index) this.comparing = false;
  }

  setUncertain(on) {
    this.uncertain = on && this.canDoubt;
    if (this.uncertain) this.comparing = false;
  }

  compare(index) {
    const count = this.result.photographs.length;
    if (!count) return;
    this.photograph = ((index % count) + count) % count;
    this.comparing = true;
    this.map = 0;
    this.uncertain = false;
  }

  setExposure(stops) {
    this.exposure = Math.max(-4, Math.min(4, stops));
  }

  read(hash) {
    const given = new URLSearchParams(hash.replace(/^#/, ""));
    const number = (name, otherwise) => (Number.isFinite(parseFloat(given.get(name))) ? parseFloat(given.get(name)) : otherwise);
    const [u, v] = (given.get("light") ?? "").split(",").map(Number);
    if (Number.isFinite(u) && Number.isFinite(v)) this.setLamp(u, v);
    const name = given.get("map");
    if (name) this.setMap(1 + this.result.parameters.findIndex((p) => p.name === name));
    this.setUncertain(given.get("uncertain") === "1");
    if (given.has("photograph")) this.compare(Math.round(number("photograph", 1)) - 1);
    this.split = Math.max(0, Math.min(1, number("split", this.split)));
    this.setExposure(number("exposure", this.exposure));
    const [least, most] = relight.State.ZOOMS;
    if (given.has("zoom")) this.zoom = Math.max(least, Math.min(most, number("zoom", 1)));
    this.x = number("x", this.x);
    this.y = number("y", this.y);
    this.bare = given.get("controls") === "0";
  }

  write(fitted) {
    const said = [`light=${this.lamp.u.toFixed(3)},${this.lamp.v.toFixed(3)}`];
    if (this.map) said.push(`map=${this.result.parameters[this.map - 1].name}`);
    if (this.uncertain) said.push("uncertain=1");
    if (this.comparing) said.push(`photograph=${this.photograph + 1}`, `split=${this.split.toFixed(3)}`);
    if (this.exposure) said.push(`exposure=${this.exposure}`);
    if (!fitted) said.push(`zoom=${this.zoom.toFixed(4)}`, `x=${this.x.toFixed(1)}`, `y=${this.y.toFixed(1)}`);
    if (this.bare) said.push("controls=0");
    return `#${said.join("&")}`;
  }
};
