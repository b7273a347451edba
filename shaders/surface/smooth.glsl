// Over W×H texels: empirical Bayes over the slopes of the 5×5 texels around. They follow a plane, s ≈ m + G d at the
// offset d, up to a relief of variance t² that differs from place to place. Plane and t² come from the neighbours alone
// by a random-effects regression (DerSimonian & Laird 1986, Meta-analysis in Clinical Trials; with covariates: Thompson
// & Sharp 1999, Explaining Heterogeneity in Meta-analysis). A neighbour has the precision 1 / (v + t²), v the variance
// of its noise, and the multiplicity exp(−½ (s − s')² / (h² + v + v')), so that steps of the surface end the plane.
// The texel's slope is the posterior mean: s + P (P + T)⁻¹ (m − s), T = t² plus the variance of m.
// P is SMOOTHNESS times the covariance in u_covariance. Reads u_field (slopes), geometry, packing. Writes o_field.

#include "surface/slopes.glsl"
#include "surface/loops.glsl"
#include "common/taps.glsl"

// h, as a slope of the surface: 6°.
#define LIKENESS 0.1
// Smallest number of like neighbours that make a plane.
#define MIN_COUNT 3.0

// Sums over the neighbours: xxᵀ with the weights w, w² and k w (k the multiplicity, w = k / (v + t²)), xyᵀ and y² with
// w, and k. x = (1, d), y = the slopes less the texel's own.
struct Sums {
    mat3 w;
    mat3 w_squared;
    mat3 k_w;
    mat2x3 y;
    float squares;
    float count;
};

float variance_at(ivec2 texel)
{
    vec3 covariance = texelFetch(u_covariance, texel, 0).xyz;
    return 0.5 * SMOOTHNESS * (covariance.x + covariance.z);
}

Sums sums_over_neighbours(ivec2 texel, ivec4 place, float h_squared, float t2)
{
    vec2 own = texelFetch(u_field, texel, 0).xy;
    float own_variance = variance_at(texel);
    Sums p = Sums(mat3(0.0), mat3(0.0), mat3(0.0), mat2x3(0.0), 0.0, 0.0);
    for (int t = 0; t < TAPS; t++) {
        ivec2 offset = tap_at(t);
        ivec2 other = connected_at(place, offset);
        float v = other.x >= 0 ? variance_at(other) : 0.0;
        if (!(v > 0.0)) {
            continue;
        }
        vec2 y = texelFetch(u_field, other, 0).xy - own;
        float k = exp(-0.5 * dot(y, y) / (h_squared + v + own_variance));
        float w = k / (v + t2);
        vec3 x = vec3(1.0, vec2(offset));
        mat3 xx = outerProduct(x, x);
        p.w += w * xx;
        p.w_squared += w * w * xx;
        p.k_w += k * w * xx;
        p.y += w * outerProduct(x, y);
        p.squares += w * dot(y, y);
        p.count += k;
    }
    return p;
}

float trace_of_product(mat3 a, mat3 b)
{
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]);  // of symmetric matrices
}

// Returns the inverse of the normal matrix. Neighbours on one line do not determine the gradient across it: it is 0.
mat3 inverse_of(mat3 a)
{
    float ridge = 1e-4 * a[0][0];
    a[1][1] += ridge;
    a[2][2] += ridge;
    return inverse(a);
}

bool texel_kernel(ivec2 texel)
{
    vec4 field = texelFetch(u_field, texel, 0);
    o_field = field;
    vec3 covariance = SMOOTHNESS * texelFetch(u_covariance, texel, 0).xyz;
    if (!(covariance.x + covariance.z > 0.0)) {
        return true;
    }
    Grid g = grid_at(texel);
    float area = abs(g.step_x.x * g.step_y.y - g.step_x.y * g.step_y.x);
    ivec4 place = surface_place_of(texel);
    Sums p = sums_over_neighbours(texel, place, LIKENESS * LIKENESS * area, 0.0);
    if (p.count < MIN_COUNT) {
        return true;
    }
    mat3 inverse_w = inverse_of(p.w);
    mat2x3 plane = inverse_w * p.y;
    // Both components of the slope share t²: their mean sum of squares.
    float q = 0.5 * (p.squares - dot(plane[0], p.y[0]) - dot(plane[1], p.y[1]));
    float freedom = p.count - trace_of_product(inverse_w, p.k_w);
    float t2 = max((q - freedom) / max(p.w[0][0] - trace_of_product(inverse_w, p.w_squared), 1e-30), 0.0);
    p = sums_over_neighbours(texel, place, LIKENESS * LIKENESS * area, t2);
    inverse_w = inverse_of(p.w);
    plane = inverse_w * p.y;
    vec2 away = vec2(plane[0].x, plane[1].x);
    float variance = t2 + inverse_w[0][0];
    // Solves (P + T) z = m − s.
    float xx = covariance.x + variance;
    float yy = covariance.z + variance;
    vec2 z = vec2(yy * away.x - covariance.y * away.y, xx * away.y - covariance.y * away.x) /
             (xx * yy - covariance.y * covariance.y);
    o_field.xy = field.xy + covariance_times(covariance, z);
    return true;
}
