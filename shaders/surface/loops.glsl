// Loops of 2×2 texels and their circulation, C s, as a function of the slopes s. A loop begins at its texel of lowest x
// and y. The slope along an edge is the mean of the slopes at its ends.

// Returns the factors of C on the slopes of one texel of a loop. by: its offset from the first texel, (0, 0) to (1, 1).
vec2 circulation_factors(ivec2 by)
{
    return by == ivec2(0, 0) ? vec2(0.5, -0.5) : by == ivec2(1, 0) ? vec2(0.5, 0.5)
         : by == ivec2(1, 1) ? vec2(-0.5, 0.5) : vec2(-0.5, -0.5);
}

// Returns Cᵀ y at a texel: the sum over its four loops, which begin here, left, left below (beyond) and below.
vec2 c_transpose(float here, float left, float beyond, float below)
{
    return 0.5 * ((here - beyond) * vec2(1.0, -1.0) + (left - below) * vec2(1.0, 1.0));
}

// Returns the symmetric matrix ``covariance`` (xx, xy, yy) times v.
vec2 covariance_times(vec3 covariance, vec2 v)
{
    return vec2(dot(covariance.xy, v), dot(covariance.yz, v));
}
