// Coloured triangles, in display values.

#include "window/screen.glsl"

void main()
{
    o_color = on_screen(v_color);
}
