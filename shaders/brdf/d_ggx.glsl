// Distribution of microfacet normals. Walter, Marschner, Li & Torrance 2007, Microfacet Models for Refraction through
// Rough Surfaces, Eq. 33; Trowbridge & Reitz 1975, Average Irregularity Representation of a Rough Surface.

// D = α² / (π (cos²θ_h (α² − 1) + 1)²), written with sin²θ_h + α² cos²θ_h, which does not cancel.
// sin2_h = 1 − NoH² (given apart: see angles.glsl), alpha in (0, 1].
float D_GGX(float NoH, float sin2_h, float alpha)
{
    float a = alpha * NoH;
    float k = alpha / (sin2_h + a * a);
    return k * k * (1.0 / 3.14159265358979);
}
