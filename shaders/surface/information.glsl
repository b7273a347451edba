// Over W×H texels: slopes s₀ of the estimated normals and their covariance P. P follows from the normal equations,
// divided by the noise, with the linear parameters eliminated: the inverse Schur complement of the normal.
// Reads the estimates, the sample stack, u_noise, geometry and packing.
// Writes o_field: (slopes along x and y, 0, 0), and o_covariance: (xx, xy, yy, 1 if a loop begins at the texel).

#include "common/estimate.glsl"
#include "surface/normal_matrix.glsl"
#include "surface/slopes.glsl"

// Returns the covariance (xx, xy, yy) of the normal's two angles.
vec3 covariance_of_angles(ivec2 texel, inout float c[MAX_COMPONENTS])
{
    float a[FREE_COUNT * FREE_COUNT];
    float noise = eliminate_all_but_normal(texel, c, a);
    int entry = NORMAL_FREE * FREE_COUNT + NORMAL_FREE;
    // Not below the precision of the weak prior: a smaller remainder of the elimination is rounding.
    float xx = max(a[entry], noise);
    float yy = max(a[entry + FREE_COUNT + 1], noise);
    float xy = clamp(a[entry + 1], -0.999 * sqrt(xx * yy), 0.999 * sqrt(xx * yy));
    float width = free_at(NORMAL_FREE).width;
    return noise * width * width / (xx * yy - xy * xy) * vec3(yy, -xy, xx);
}

// Returns whether the 2×2 texels from this one on are connected on the surface.
bool begins_loop(ivec4 place)
{
    return connected_at(place, ivec2(1, 0)).x >= 0 && connected_at(place, ivec2(0, 1)).x >= 0 &&
           connected_at(place, ivec2(1, 1)).x >= 0;
}

bool texel_kernel(ivec2 texel)
{
    o_field = vec4(0.0);
    o_covariance = vec4(0.0);
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[MAX_COMPONENTS];
    material_to(estimate_at(texel), c);
    vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
    Grid g = grid_at(texel);
    float area = abs(g.step_x.x * g.step_y.y - g.step_x.y * g.step_y.x);
    // Parallel steps. Skips NaN as well.
    if (!(area > 0.0)) {
        return true;
    }
    // Below MIN_FACING the slope is not finite, and the normal stays: covariance 0.
    vec3 angle_covariance = facing_of(g, n) > MIN_FACING ? covariance_of_angles(texel, c) : vec3(0.0);
    vec3 axis = turning_axis(n);
    vec2 d1 = slope_derivative(g, n, axis);
    vec2 d2 = slope_derivative(g, n, cross(n, axis));
    vec2 p1 = angle_covariance.x * d1 + angle_covariance.y * d2;
    vec2 p2 = angle_covariance.y * d1 + angle_covariance.z * d2;
    o_field.xy = slopes_of(g, n);
    o_covariance.xyz = vec3(p1.x * d1.x + p2.x * d2.x, p1.x * d1.y + p2.x * d2.y,
                            p1.y * d1.y + p2.y * d2.y);
    o_covariance.w = begins_loop(surface_place_of(texel)) ? 1.0 : 0.0;
    return true;
}
