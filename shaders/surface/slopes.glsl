// Slopes of the surface at a texel: its rise above the domain's own surface over one step to the next texel in x and in
// y. On a card under a perspective camera, the slope is the rise of −log depth, in units of the card's distance (Quéau,
// Durou & Aujol 2018, Normal Integration: A Survey, Section 2.3). Reads the geometry, the packing and the observation
// table.

#include "common/observation.glsl"
#include "common/packing.glsl"

// Lower limit of the cosine to the view. At 0 the slope is infinite.
#define MIN_FACING 0.1

// step_x, step_y: vectors to the next texel along x and y, in the texel's tangent plane; 0 without a neighbour on that
// axis. view_slope: the view direction is along (view_slope, 1).
struct Grid {
    vec2 step_x;
    vec2 step_y;
    vec2 view_slope;
};

// Returns whether two UV neighbours are neighbours on the surface. a, b: their surface_place_of().
bool are_connected(ivec4 a, ivec4 b)
{
    return a.z == b.z || a.z == b.w || a.w == b.z;
}

// Returns the packed texel at an offset, or (−1, −1) where none is solved or a UV seam lies between.
ivec2 connected_at(ivec4 from, ivec2 offset)
{
    ivec2 other = packed_at(from.xy + offset);
    return other.x >= 0 && are_connected(from, surface_place_of(other)) ? other : ivec2(-1);
}

// Returns the vector to the next texel, in the tangent plane: with two neighbours, half the vector between them.
vec2 step_along(Frame f, ivec4 place, ivec2 offset)
{
    ivec2 ahead = connected_at(place, offset);
    ivec2 behind = connected_at(place, -offset);
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
    g.view_slope = vec2(0.0);
#if defined(CARD) && defined(ONE_VIEW)
    vec3 v = view_at(f, 0);
    g.view_slope = v.xy / max(v.z, MIN_FACING);
#endif
    return g;
}

float facing_of(Grid g, vec3 n)
{
    return max(n.z + dot(n.xy, g.view_slope), MIN_FACING);
}

// Returns slopes along x and y from slopes in the tangent plane.
vec2 along_grid(Grid g, vec2 slope)
{
    return vec2(dot(g.step_x, slope), dot(g.step_y, slope));
}

vec2 slopes_of(Grid g, vec3 n)
{
    return along_grid(g, -n.xy / facing_of(g, n));
}

// Returns the derivative of the slopes by the normal, in the direction d.
vec2 slope_derivative(Grid g, vec3 n, vec3 d)
{
    float facing = facing_of(g, n);
    return along_grid(g, n.xy * (d.z + dot(d.xy, g.view_slope)) / (facing * facing) - d.xy / facing);
}

// Returns the unit normal of slopes. The steps must not be parallel.
vec3 normal_of(Grid g, vec2 slopes)
{
    float area = g.step_x.x * g.step_y.y - g.step_x.y * g.step_y.x;
    vec2 slope =
        vec2(g.step_y.y * slopes.x - g.step_x.y * slopes.y, g.step_x.x * slopes.y - g.step_y.x * slopes.x) / area;
    return normalize(vec3(-slope, max(1.0 + dot(slope, g.view_slope), 0.0)));
}
