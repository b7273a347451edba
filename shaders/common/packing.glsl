// Packing: all textures of a recovery store the solved texels densely. Reads GEOMETRY_PLACE of u_geometry (packed texel
// → domain texel) and u_packed (domain texel → packed texel, −1 where none is solved).
//
// SEAMS is the radius of a seam map (geometry/seams/seams.py). With it, solver/state/packing.py writes:
//   GEOMETRY_PLACE: x, y, chart, island. Islands share edges in the UV map. A chart is an island or, at a gap, a part.
//   u_packed, with a border of SEAMS texels: packed x, y, chart, first entry for views from other charts (−1: none).
//   entries, in the layers after GEOMETRY_PLACE, in texel order: packed x, y, the chart that sees it, next entry.

#include "common/geometry.glsl"

ivec2 domain_texel_of(ivec2 packed_texel)
{
    return ivec2(geometry_at(GEOMETRY_PLACE, packed_texel).xy);
}

// Returns the packed texel of a domain texel, or (−1, −1) where no texel is solved.
ivec2 packed_at(ivec2 domain_texel)
{
#ifdef SEAMS
    domain_texel += SEAMS;
#endif
    if (any(lessThan(domain_texel, ivec2(0))) || any(greaterThanEqual(domain_texel, textureSize(u_packed, 0)))) {
        return ivec2(-1);
    }
    return ivec2(texelFetch(u_packed, domain_texel, 0).xy);
}

// Returns the place of a packed texel on the surface: x, y, chart, island.
ivec4 surface_place_of(ivec2 packed_texel)
{
#ifdef SEAMS
    return ivec4(geometry_at(GEOMETRY_PLACE, packed_texel));
#else
    return ivec4(domain_texel_of(packed_texel), 0, 0);
#endif
}

// Returns the packed texel at an offset on the surface, across UV seams, or (−1, −1) where none is solved.
ivec2 neighbour_at(ivec4 from, ivec2 offset)
{
#ifdef SEAMS
    ivec2 domain_texel = from.xy + offset + SEAMS;
    if (any(lessThan(domain_texel, ivec2(0))) || any(greaterThanEqual(domain_texel, textureSize(u_packed, 0)))) {
        return ivec2(-1);
    }
    vec4 packed_entry = texelFetch(u_packed, domain_texel, 0);
    int chart = int(packed_entry.z);
    if (chart == from.z || chart == from.w) {
        return ivec2(packed_entry.xy);
    }
    ivec2 size = textureSize(u_geometry, 0).xy;
    int entry_index = int(packed_entry.w);
    while (entry_index >= 0) {
        int row = entry_index / size.x;
        vec4 entry = geometry_at(GEOMETRY_PLACE + 1 + row / size.y, ivec2(entry_index % size.x, row % size.y));
        if (int(entry.z) == from.z) {
            return ivec2(entry.xy);
        }
        entry_index = int(entry.w);
    }
    return ivec2(-1);
#else
    return packed_at(from.xy + offset);
#endif
}
