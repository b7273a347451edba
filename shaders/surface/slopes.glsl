// Slopes of the surface in a texel: the rise along a step to the next texel in x and in y, of a surface that lies above the
// domain's own. On a card seen by a perspective camera it is the rise of −log depth, per unit of the card's distance
// (Quéau, Durou & Aujol 2018, Normal Integration: A Survey, Section 2.3).
// Reads the geometry, the packing and the observation table.

#include "common/observation.glsl"
#include "common/packing.glsl"

// The slope of a surface that turns away is infinite.
#define LEAST_FACING 0.1

// step_x, step_y: the way to the next texel along x and y, in the texel's tangent plane; 0 without a neighbour on that
// axis. lean: the view is along (lean, 1).
struct Grid {
    vec2 step_x;
    vec2 step_y;
    vec2 lean;
};

// Whether two texels that are neighbours in the UV map are neighbours on the surface: surface_place_of of both.
bool are_joined(ivec4 a, ivec4 b)
{
    return a.z == b.z || a.z == b.w || a.w == b.z;
}

// Returns the packed texel at an offset, or (−1, −1) where none is solved, or where a UV seam lies between.
ivec2 joined_at(ivec4 from, ivec2 by)
{
    ivec2 there = packed_at(from.xy + by);
    return there.x >= 0 && are_joined(from, surface_place_of(there)) ? there : ivec2(-1);
}

// The way from a texel to the next, in its tangent plane: half of that between both neighbours where there are two.
vec2 step_along(Frame f, ivec4 place, ivec2 by)
{
    ivec2 ahead = joined_at(place, by);
    ivec2 behind = joined_at(place, -by);
    vec3 to = ahead.x >= 0 ? geometry_at(GEOMETRY_POSITION, ahead).xyz : f.position;
    vec3 from = behind.x >= 0 ? geometry_at(GEOMETRY_POSITION, behind).xyz : f.position;
    return to_local(f, to - from).xy * (ahead.x >= 0 && behind.x >= 0 ? 0.5 : 1.0);
}

Grid grid_at(ivec2 texel)
{
    Grid g;
    Frame f = frame_at(texel);
    ivec4 place = surface_place_of(texel);
    g.step_x = step_along(f, place, ivec2(1, 0));
    g.step_y = step_along(f, place, ivec2(0, 1));
    g.lean = vec2(0.0);
#if defined(CARD) && defined(ONE_VIEW)
    vec3 v = view_at(f, 0);
    g.lean = v.xy / max(v.z, LEAST_FACING);
#endif
    return g;
}

float facing_of(Grid g, vec3 n)
{
    return max(n.z + dot(n.xy, g.lean), LEAST_FACING);
}

// Slopes along x and y from those in the tangent plane.
vec2 along_grid(Grid g, vec2 slope)
{
    return vec2(dot(g.step_x, slope), dot(g.step_y, slope));
}

vec2 slopes_of(Grid g, vec3 n)
{
    return along_grid(g, -n.xy / facing_of(g, n));
}

// How the slopes change as the normal moves by d.
vec2 slopes_by(Grid g, vec3 n, vec3 d)
{
    float facing = facing_of(g, n);
    return along_grid(g, n.xy * (d.z + dot(d.xy, g.lean)) / (facing * facing) - d.xy / facing);
}

// The unit normal of slopes. The steps must not be parallel.
vec3 normal_of(Grid g, vec2 slopes)
{
    float area = g.step_x.x * g.step_y.y - g.step_x.y * g.step_y.x;
    vec2 slope = vec2(g.step_y.y * slopes.x - g.step_x.y * slopes.y, g.step_x.x * slopes.y - g.step_y.x * slopes.x) / area;
    return normalize(vec3(-slope, max(1.0 + dot(slope, g.lean), 0.0)));
}
