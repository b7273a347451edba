// Texture layout of a large swarm. A block has four dimensions; the blocks of all particles are stacked vertically,
// u_rows rows each. DIMENSIONS, PARTICLES: of the swarm.

#define BLOCKS ((DIMENSIONS + 3) / 4)

int particle_of(ivec2 texel, int width)
{
    return (texel.y % u_rows) * width + texel.x;
}

ivec2 place_of_block(int particle, int block, int width)
{
    return ivec2(particle % width, block * u_rows + particle / width);
}
