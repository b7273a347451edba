// Encodings of a normal as searched numbers in [0, 1]: two on the hemisphere, or three that are normalised.

// Maps the square to the disc by ellipses (Fong 2015, Analytical Methods for Squaring the Disc), and the disc to the
// hemisphere z ≥ 0 with equal areas (Lambert 1772, azimuthal projection). No pole, no trigonometry; the square's edges
// are the horizon. A square around the disc would have a fifth of its area on the horizon, where every render is black:
// on dark subjects more than half of the swarms converged there.
vec3 normal_from_hemisphere(vec2 x)
{
    vec2 q = 2.0 * x - 1.0;
    vec2 d = q * sqrt(1.0 - 0.5 * q.yx * q.yx);
    float squared = min(dot(d, d), 1.0);
    return vec3(d * sqrt(2.0 - squared), 1.0 - squared);
}

vec2 hemisphere_from_normal(vec3 n)
{
    vec2 d;
    if (n.z <= 0.0) {
        // max(): the normal (0, 0, −1) has no direction in the horizon's plane. Any result is valid.
        d = n.xy * inversesqrt(max(dot(n.xy, n.xy), 1e-20));
    }
    else {
        d = n.xy * inversesqrt(1.0 + n.z);
    }
    vec2 e = 2.0 + d * d - d.yx * d.yx;
    vec2 q = 0.5 * (sqrt(max(e + 2.82842712 * d, 0.0)) - sqrt(max(e - 2.82842712 * d, 0.0)));
    return clamp(0.5 * q + 0.5, 0.0, 1.0);
}

// Returns the largest albedo that is searched. Radiance is proportional to it, so the brightness bounds it.
// ALBEDO_LIMIT times the brightness includes saturated colours under grazing light; 0 searches the whole range.
float albedo_limit_of(float radiance_scale)
{
    return ALBEDO_LIMIT > 0.0 ? ALBEDO_LIMIT * radiance_scale : 1e30;
}

// The paper's encoding: three numbers, normalised. A negative z is mirrored, so that the normal lies in the hemisphere.
vec3 normal_from_cartesian(vec3 x)
{
    vec3 n = 2.0 * x - 1.0;
    float squared = dot(n, n);
    // 1e-12: the centre of the cube has no direction. Points this near to it decode to the frame's normal.
    return squared > 1e-12 ? vec3(n.xy, abs(n.z)) * inversesqrt(squared) : vec3(0.0, 0.0, 1.0);
}

vec3 cartesian_from_normal(vec3 n)
{
    return 0.5 * n + 0.5;
}
