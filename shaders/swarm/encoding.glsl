// How a normal is searched: as numbers in [0, 1], two on the hemisphere or three that are normalised.

// Equal-area map of the disc on the hemisphere z ≥ 0 (Lambert 1772, azimuthal projection): no pole, no trigonometry,
// and equal steps of a particle are equal solid angles. Corners outside the disc lie on the horizon.
vec3 normal_from_hemisphere(vec2 x)
{
    vec2 d = 2.0 * x - 1.0;
    float squared = dot(d, d);
    if (squared > 1.0) {
        return vec3(d * inversesqrt(squared), 0.0);
    }
    return vec3(d * sqrt(2.0 - squared), 1.0 - squared);
}

vec2 hemisphere_from_normal(vec3 n)
{
    vec2 d;
    if (n.z <= 0.0) {
        // max: a normal pointing straight away from the hemisphere has no direction on the horizon; any will do.
        d = n.xy * inversesqrt(max(dot(n.xy, n.xy), 1e-20));
    }
    else {
        d = n.xy * inversesqrt(1.0 + n.z);
    }
    return 0.5 * d + 0.5;
}

// The paper's three numbers, normalised. z is mirrored up: a texel's normal faces its hemisphere.
vec3 normal_from_cartesian(vec3 x)
{
    vec3 n = 2.0 * x - 1.0;
    float squared = dot(n, n);
    // 1e-12: the centre of the cube has no direction; anything nearer is taken for the frame's own normal.
    return squared > 1e-12 ? vec3(n.xy, abs(n.z)) * inversesqrt(squared) : vec3(0.0, 0.0, 1.0);
}

vec3 cartesian_from_normal(vec3 n)
{
    return 0.5 * n + 0.5;
}
