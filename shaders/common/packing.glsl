// Solved texels lie densely packed in all textures of a recovery. Reads GEOMETRY_PLACE of u_geometry (the domain's texel
// of a packed one) and u_packed (the packed texel of a domain's, −1 where none is solved).
//
// With SEAMS, the reach of a seam map (geometry/seams/seams.py), written by solver/state/packing.py:
//   GEOMETRY_PLACE: x, y, chart, island. Islands share edges in the UV map; a chart is an island or, beside a gap, a part.
//   u_packed, with a border of SEAMS texels: packed x, y, chart, first entry of what other charts see here (−1: none).
//   entries, in the layers after GEOMETRY_PLACE, texel by texel: packed x, y, the chart that sees it, next entry.

#include "common/geometry.glsl"

ivec2 place_of(ivec2 packed_texel)
{
    return ivec2(geometry_at(GEOMETRY_PLACE, packed_texel).xy);
}

// Returns the packed texel, or (−1, −1) where no texel is solved.
ivec2 packed_at(ivec2 place)
{
#ifdef SEAMS
    place += SEAMS;
#endif
    if (any(lessThan(place, ivec2(0))) || any(greaterThanEqual(place, textureSize(u_packed, 0)))) {
        return ivec2(-1);
    }
    return ivec2(texelFetch(u_packed, place, 0).xy);
}

// The place of a packed texel on the surface: x, y, chart, island.
ivec4 surface_place_of(ivec2 packed_texel)
{
#ifdef SEAMS
    return ivec4(geometry_at(GEOMETRY_PLACE, packed_texel));
#else
    return ivec4(place_of(packed_texel), 0, 0);
#endif
}

// Returns the packed texel at an offset on the surface, across UV seams, or (−1, −1) where none is solved.
ivec2 neighbour_at(ivec4 from, ivec2 by)
{
#ifdef SEAMS
    ivec2 place = from.xy + by + SEAMS;
    if (any(lessThan(place, ivec2(0))) || any(greaterThanEqual(place, textureSize(u_packed, 0)))) {
        return ivec2(-1);
    }
    vec4 there = texelFetch(u_packed, place, 0);
    int chart = int(there.z);
    if (chart == from.z || chart == from.w) {
        return ivec2(there.xy);
    }
    ivec2 size = textureSize(u_geometry, 0).xy;
    int next = int(there.w);
    while (next >= 0) {
        int row = next / size.x;
        vec4 entry = geometry_at(GEOMETRY_PLACE + 1 + row / size.y, ivec2(next % size.x, row % size.y));
        if (int(entry.z) == from.z) {
            return ivec2(entry.xy);
        }
        next = int(entry.w);
    }
    return ivec2(-1);
#else
    return packed_at(from.xy + by);
#endif
}
