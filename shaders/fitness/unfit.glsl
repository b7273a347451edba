// No render is this far off; also the fitness of a texel that no observation sees.
#define UNFIT 1e30
