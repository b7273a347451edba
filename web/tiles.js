"use strict";
// Tiles of maps and photographs: loaded as scripts when they are first drawn, kept as textures, and forgotten when there
// are too many.

window.relight = {};

relight.Tiles = class {
  // planes: kind → how many layers a tile has. changed: called when a tile has arrived.
  constructor(gl, planes, changed) {
    this.gl = gl;
    this.planes = planes;
    this.changed = changed;
    this.held = new Map(); // name → {texture, bytes}; those used last stand last
    this.waiting = new Map(); // name → what takes its pictures
    this.bytes = 0;
    relight.tile = (name, pictures) => this.waiting.get(name)?.(pictures);
  }

  static PARALLEL = 6;
  static MOST = 192 * 2 ** 20; // bytes of textures, of which those in sight never go

  // The texture of a tile, null while it is not there.
  texture(name) {
    const found = this.held.get(name);
    if (!found) return null;
    this.held.delete(name);
    this.held.set(name, found);
    return found.texture;
  }

  // Loads the first of the names that are absent, and lets go of what is neither named nor recent.
  want(names) {
    for (const name of names) {
      if (this.waiting.size >= relight.Tiles.PARALLEL) break;
      if (!this.held.has(name) && !this.waiting.has(name)) this.load(name);
    }
    const wanted = new Set(names);
    for (const [name, { texture, bytes }] of this.held) {
      if (this.bytes <= relight.Tiles.MOST) break;
      if (wanted.has(name)) continue;
      this.gl.deleteTexture(texture);
      this.held.delete(name);
      this.bytes -= bytes;
    }
  }

  async load(name) {
    try {
      const pictures = await this.pictures(name);
      const images = await Promise.all(pictures.map(decoded));
      this.held.set(name, this.upload(images, this.planes(name)));
    } catch (fault) {
      this.held.set(name, { texture: null, bytes: 0 }); // not asked for again
      relight.fault(`The file tiles/${name}.js cannot be read. Copy the whole folder.`);
    }
    this.waiting.delete(name);
    this.changed();
  }

  // A script, since a page that is opened as a file may read nothing else.
  pictures(name) {
    return new Promise((resolve, reject) => {
      const script = document.createElement("script");
      this.waiting.set(name, resolve);
      script.src = `tiles/${name}.js`;
      script.onerror = reject;
      script.onload = () => {
        script.remove();
        reject(); // nothing where it has called relight.tile; a script that was cut off has not
      };
      document.head.append(script);
    });
  }

  upload(images, layers) {
    const gl = this.gl, { width, height } = images[0];
    const texture = gl.createTexture(), bytes = 4 * width * height * layers;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, width, height, layers);
    // The bytes are numbers: no colour management.
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    images.forEach((image, layer) => {
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, width, height, 1, gl.RGBA, gl.UNSIGNED_BYTE, image);
    });
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.bytes += bytes;
    return { texture, bytes };
  }
};

async function decoded(uri) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  return image;
}
