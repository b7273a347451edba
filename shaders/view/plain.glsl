// Coloured triangles, display values.

#include "view/screen.glsl"

void main()
{
    o_color = on_screen(v_color);
}
