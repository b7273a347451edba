// Writes texel (x, y) of layer u_layer of an array texture.

bool texel_kernel(ivec2 texel)
{
    o_value = texelFetch(u_layers, ivec3(texel, u_layer), 0);
    return true;
}
