// Constant data of a texel, in the layers of u_geometry: one texture, because some GPUs bind only 16.

#define GEOMETRY_POSITION 0 // xyz, state (common/frame.glsl)
#define GEOMETRY_NORMAL 1 // xyz, radiance scale
#define GEOMETRY_TANGENT 2 // xyz, sign · (1 + shadow)
#define GEOMETRY_PLACE 3 // common/packing.glsl, and all layers after it

vec4 geometry_at(int layer, ivec2 texel)
{
    return texelFetch(u_geometry, ivec3(texel, layer), 0);
}
