// Fitness of a texel without observations. It exceeds the fitness of every render.
#define UNFIT 1e30
