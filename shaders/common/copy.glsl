// Copies a texture. After a compute dispatch this fragment pass makes the output safe to read back.

bool texel_kernel(ivec2 texel)
{
    o_copy = texelFetch(u_source, texel, 0);
    return true;
}
