// Copies a texture texel by texel: what a compute dispatch has written is safe to read back after a fragment pass.

bool texel_kernel(ivec2 texel)
{
    o_copy = texelFetch(u_source, texel, 0);
    return true;
}
