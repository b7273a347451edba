// Copies numbers of a texel between RGBA textures and an array, four at a time. The generated functions read_NAME and
// write_NAME use it (Packed of gpu/kernel.py).

#include "common/limits.glsl"

#define UNPACK(source, texel, c, i) { vec4 four = texelFetch(source, texel, 0); c[i] = four.x; c[i + 1] = four.y; c[i + 2] = four.z; c[i + 3] = four.w; }
#define PACK(c, i) vec4(c[i], c[i + 1], c[i + 2], c[i + 3])
