// Layout of the particles. A swarm texture is an atlas of tiles of W×H texels. One tile holds four dimensions of one
// particle of every texel. Order: particles 0 … m−1 with dimensions 0–3, then particles 0 … m−1 with dimensions 4–7.
// BLOCKS is 1 for up to four dimensions and 2 for up to eight. A row of the atlas has TILES_X tiles.

ivec2 atlas_texel(ivec2 texel, int block, int particle)
{
    int tile = block * PARTICLES + particle;
    return texel + ivec2(tile % TILES_X, tile / TILES_X) * ivec2(u_width, u_height);
}

// Reads all dimensions of one particle, up to eight.
void read_particle(sampler2D atlas, ivec2 texel, int particle, out float x[MAX_DIMENSIONS])
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

// Returns the four dimensions of a particle that one block stores.
vec4 block_of(inout float x[MAX_DIMENSIONS], int block)
{
    return vec4(x[4 * block], x[4 * block + 1], x[4 * block + 2], x[4 * block + 3]);
}

// Finds texel, block and particle of an atlas texel. Returns false on tiles without a particle.
bool atlas_owner(ivec2 atlas_coord, out ivec2 texel, out int block, out int particle)
{
    ivec2 size = ivec2(u_width, u_height);
    // Division in floats, because integer division is slow on every GPU. The result is exact while the rounding of the
    // quotient, at most 200 tiles times 2⁻²⁴, is below half a texel of a tile, 0.5 / 16384.
    ivec2 tile_coord = ivec2((vec2(atlas_coord) + 0.5) / vec2(size));
    int tile = tile_coord.y * TILES_X + tile_coord.x;
    texel = atlas_coord - tile_coord * size;
    block = tile / PARTICLES;
    particle = tile - block * PARTICLES;
    return tile < BLOCKS * PARTICLES;
}
