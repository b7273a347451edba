// The layout of particles. A swarm texture is an atlas of tiles of W×H texels, one tile for four dimensions of
// one particle: particles 0 … m−1 with dimensions 0–3, then the same with dimensions 4–7.
// BLOCKS is 1 up to four dimensions and 2 up to eight; TILES_X tiles stand side by side.

ivec2 atlas_texel(ivec2 texel, int block, int particle)
{
    int tile = block * PARTICLES + particle;
    return texel + ivec2(tile % TILES_X, tile / TILES_X) * ivec2(u_width, u_height);
}

// Reads all numbers of one particle, up to eight.
void read_particle(sampler2D atlas, ivec2 texel, int particle, out float x[8])
{
    vec4 part = texelFetch(atlas, atlas_texel(texel, 0, particle), 0);
    for (int i = 0; i < 4; i++) {
        x[i] = part[i];
    }
#if BLOCKS > 1
    part = texelFetch(atlas, atlas_texel(texel, 1, particle), 0);
#endif
    for (int i = 0; i < 4; i++) {
        x[4 + i] = part[i];
    }
}

// The four numbers of a particle that lie in one block.
vec4 block_of(inout float x[8], int block)
{
    return vec4(x[4 * block], x[4 * block + 1], x[4 * block + 2], x[4 * block + 3]);
}

// Finds the particle of an atlas texel; returns false on tiles without a particle.
bool atlas_owner(ivec2 place, out ivec2 texel, out int block, out int particle)
{
    ivec2 size = ivec2(u_width, u_height);
    // In floats, because integer division is slow on every GPU: right while the quotient's rounding, at most 200 tiles
    // times 2⁻²⁴, stays under half a texel of a tile, 0.5 / 16384.
    ivec2 at = ivec2((vec2(place) + 0.5) / vec2(size));
    int tile = at.y * TILES_X + at.x;
    texel = place - at * size;
    block = tile / PARTICLES;
    particle = tile - block * PARTICLES;
    return tile < BLOCKS * PARTICLES;
}
