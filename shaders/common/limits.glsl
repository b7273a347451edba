// Rooms of arrays: the most numbers of a texel that textures hold, four to each. Python reads them (core/files.py).

#define MAX_COMPONENTS 12  // of all parameters of a model
#define MAX_DIMENSIONS 8   // of a particle
#define MAX_WEIGHTS 8      // linear weights of a swarm's best
#define MAX_PARTICLES 16   // of a synchronous swarm
