// Fresnel reflectance of a dielectric, unpolarised light. Fresnel 1823; in the form of Cook & Torrance 1982,
// A Reflectance Model for Computer Graphics, Eq. 18.

// F = ½ ((g − c) / (g + c))² (1 + ((c (g + c) − 1) / (c (g − c) + 1))²), g = √(ior² − 1 + c²).
// c = v·h > 0; ior >= 1, relative to the outer medium. g − c = (ior² − 1) / (g + c) does not cancel as ior goes to 1.
float F_Dielectric(float c, float ior)
{
    float ior2_minus_1 = ior * ior - 1.0;
    float sum = sqrt(ior2_minus_1 + c * c) + c;
    float difference = ior2_minus_1 / sum;
    float a = difference / sum;
    float b = (c * sum - 1.0) / (c * difference + 1.0);
    return 0.5 * a * a * (1.0 + b * b);
}

// Returns the index of refraction with reflectance F0 in [0, 1) at normal incidence.
float ior_from_F0(float F0)
{
    float root = sqrt(F0);
    return (1.0 + root) / (1.0 - root);
}
