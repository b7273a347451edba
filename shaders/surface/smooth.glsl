// Over W×H texels: empirical Bayes over the slopes of the 5×5 texels around. They follow a plane, s ≈ m + G d at the
// offset d, up to a relief of variance t² that differs from place to place. Plane and t² come from the neighbours alone
// by a random-effects regression (DerSimonian & Laird 1986, Meta-analysis in Clinical Trials; with covariates: Thompson
// & Sharp 1999, Explaining Heterogeneity in Meta-analysis). A neighbour has the precision 1 / (v + t²), v the variance
// of its noise, and the multiplicity exp(−½ (s − s')² / (h² + v + v')), so that steps of the surface end the plane. The
// texel's slope is the posterior mean: s + P (P + T)⁻¹ (m − s), T = t² plus the variance of m. P is SMOOTHNESS times
// the covariance in u_covariance. All slopes are divided by the lengths of the texel's own steps: texels may be long,
// and no square overflows. Reads u_field (slopes), u_covariance, geometry and packing. Writes o_field.

#include "surface/slopes.glsl"
#include "surface/loops.glsl"
#include "common/taps.glsl"

// h, as a slope of the surface: 6°.
#define SLOPE_BANDWIDTH 0.1
// Smallest number of like neighbours that make a plane.
#define MIN_COUNT 3.0
// Smallest part of the neighbours' precision that the plane may leave for t². With less, a few neighbours that are far
// more precise than the others determine the plane alone.
#define MIN_REMAINDER 0.01
// Smallest variance of a neighbour, as a part of the texel's own: sums in float32 lose what others say beside one that
// is far more precise. With the smallest of all, 3e-6 radians squared, no determinant overflows.
#define MIN_VARIANCE_SHARE 1e-3
#define MIN_VARIANCE 1e-11

// Sums over the neighbours: xxᵀ with the weights w, w² and k w (k the multiplicity, w = k / (v + t²)), xyᵀ and y² with
// w, and k. x = (1, d), y = the slopes less the texel's own.
struct Sums {
    mat3 w;
    mat3 w_squared;
    mat3 k_w;
    vec3 y_along_x;
    vec3 y_along_y;
    float squares;
    float count;
};

// Returns the variance of a slope's noise, 0 where the slope is unknown.
float variance_at(ivec2 texel, vec2 lengths)
{
    vec2 variances = texelFetch(u_covariance, texel, 0).xz / (lengths * lengths);
    float variance = 0.5 * SMOOTHNESS * (variances.x + variances.y);
    return variance > 0.0 ? max(variance, MIN_VARIANCE) : 0.0;
}

Sums sums_over_neighbours(ivec2 texel, ivec4 place, vec2 lengths, float t2)
{
    vec2 own = texelFetch(u_field, texel, 0).xy;
    float own_variance = variance_at(texel, lengths);
    Sums p;
    p.w = mat3(0.0);
    p.w_squared = mat3(0.0);
    p.k_w = mat3(0.0);
    p.y_along_x = vec3(0.0);
    p.y_along_y = vec3(0.0);
    p.squares = 0.0;
    p.count = 0.0;
    for (int t = 0; t < TAPS; t++) {
        ivec2 offset = tap_at(t);
        ivec2 other = connected_at(place, offset);
        float v = other.x >= 0 ? variance_at(other, lengths) : 0.0;
        if (!(v > 0.0)) {
            continue;
        }
        vec2 y = (texelFetch(u_field, other, 0).xy - own) / lengths;
        v = max(v, MIN_VARIANCE_SHARE * own_variance);
        float k = exp(-0.5 * dot(y, y) / (SLOPE_BANDWIDTH * SLOPE_BANDWIDTH + v + own_variance));
        float w = k / (v + t2);
        vec3 x = vec3(1.0, vec2(offset));
        mat3 xx = mat3(x, x * x.y, x * x.z);  // x.x is 1
        p.w += w * xx;
        p.w_squared += w * w * xx;
        p.k_w += k * w * xx;
        p.y_along_x += w * y.x * x;
        p.y_along_y += w * y.y * x;
        p.squares += w * dot(y, y);
        p.count += k;
    }
    return p;
}

float trace_of_product(mat3 a, mat3 b)
{
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]);  // of symmetric matrices
}

// Returns the inverse of a symmetric normal matrix. Neighbours on one line do not determine the gradient across it: it
// is 0.
mat3 inverse_of(mat3 a)
{
    float ridge = 1e-4 * a[0][0];
    a[1][1] += ridge;
    a[2][2] += ridge;
    vec3 first = cross(a[1], a[2]);
    return mat3(first, cross(a[2], a[0]), cross(a[0], a[1])) / dot(a[0], first);
}

bool texel_kernel(ivec2 texel)
{
    vec4 field = texelFetch(u_field, texel, 0);
    o_field = field;
    Grid g = grid_at(texel);
    vec2 lengths = vec2(length(g.step_x), length(g.step_y));
    vec3 covariance = SMOOTHNESS * texelFetch(u_covariance, texel, 0).xyz / (lengths.xxy * lengths.xyy);
    if (!(covariance.x + covariance.z > 0.0)) {
        return true;
    }
    ivec4 place = surface_place_of(texel);
    Sums p = sums_over_neighbours(texel, place, lengths, 0.0);
    if (p.count < MIN_COUNT) {
        return true;
    }
    mat3 inverse_w = inverse_of(p.w);
    // Both components of the slope share t²: their mean sum of squares.
    float q = 0.5 * (p.squares - dot(inverse_w * p.y_along_x, p.y_along_x) - dot(inverse_w * p.y_along_y, p.y_along_y));
    float freedom = p.count - trace_of_product(inverse_w, p.k_w);
    float remainder = p.w[0][0] - trace_of_product(inverse_w, p.w_squared);
    if (!(remainder > MIN_REMAINDER * p.w[0][0])) {
        return true;
    }
    float t2 = max((q - freedom) / remainder, 0.0);
    p = sums_over_neighbours(texel, place, lengths, t2);
    inverse_w = inverse_of(p.w);
    vec2 away = vec2(dot(inverse_w[0], p.y_along_x), dot(inverse_w[0], p.y_along_y));
    float variance = t2 + inverse_w[0][0];
    // Solves (P + T) z = m − s.
    float xx = covariance.x + variance;
    float yy = covariance.z + variance;
    vec2 z = vec2(yy * away.x - covariance.y * away.y, xx * away.y - covariance.y * away.x) /
             (xx * yy - covariance.y * covariance.y);
    o_field.xy = field.xy + lengths * covariance_times(covariance, z);
    return true;
}
