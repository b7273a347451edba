// Distribution of microfacet normals, wider in one direction than across it. Burley 2012, Physically-Based Shading at
// Disney, Eq. 13; Walter et al. 2007 (d_ggx.glsl) where both widths are one.

// D = 1 / (π αx αy ((x·h)² / αx² + (y·h)² / αy² + (n·h)²)²), with x, y, n orthonormal; alpha_x and alpha_y in (0, 1].
// XoH and YoH: see xy_of_half below.
float D_GGXAnisotropic(float XoH, float YoH, float NoH, float alpha_x, float alpha_y)
{
    float x = XoH / alpha_x;
    float y = YoH / alpha_y;
    float k = x * x + y * y + NoH * NoH;
    return 1.0 / (3.14159265358979 * alpha_x * alpha_y * k * k);
}

// x·h and y·h of the half vector of l and v. They come from n × h, which keeps its digits near the highlight's peak; the
// rounding of x and y along n does not then enter.
vec2 xy_of_half(vec3 n, vec3 x, vec3 y, vec3 l, vec3 v)
{
    vec3 sum = l + v;
    vec3 turned = cross(n, sum) * inversesqrt(dot(sum, sum));
    return vec2(dot(turned, y), -dot(turned, x));
}
