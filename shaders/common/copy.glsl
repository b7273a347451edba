// Copies a texture texel by texel: after a fragment pass, the output of a compute dispatch is safe to read back.

bool texel_kernel(ivec2 texel)
{
    o_copy = texelFetch(u_source, texel, 0);
    return true;
}
