// Above the fitness of any render; also the fitness of a texel without observations.
#define UNFIT 1e30
