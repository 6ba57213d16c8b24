"""What the GL back end computes for each vertex and each pixel, in GLSL.

Row 0 of the frame buffer is row 0 of the image, so nothing has to be flipped when it is read.
"""

SURFACE_VERTEX = """
#version 330
uniform mat3 R_sb;         // from the frame of the body to S; the identity for what stands still
uniform vec3 from_camera;  // origin of the body minus the left camera, in S; in two parts so that single precision
uniform vec3 remainder;    // is enough far from the origin
uniform mat3 R_cs;
uniform float eye;         // of the eye along the camera's x axis
uniform mat4 projection;
in vec3 position;
in vec3 normal;
in vec3 texel;             // u, v, layer
in vec3 color;
out vec3 at_texel;
out vec3 at_normal;
out vec3 tint;
void main() {
    vec3 p_c = R_cs * ((R_sb * position + from_camera) + remainder);
    gl_Position = projection * vec4(p_c.x - eye, p_c.yz, 1.0);
    at_texel = texel;
    at_normal = R_sb * normal;
    tint = color;
}
"""

SURFACE_FRAGMENT = """
#version 330
uniform sampler2DArray textures;
uniform vec3 sun;          // unit vector in S
uniform vec2 light;        // ambient, diffuse
uniform vec3 horizon;
uniform float haze;        // 1/m
in vec3 at_texel;
in vec3 at_normal;
in vec3 tint;
out vec4 shade;
void main() {
    float brightness = light.x + light.y * max(0.0, dot(normalize(at_normal), sun));
    vec3 lit = min(texture(textures, at_texel).rgb * tint * brightness, 1.0);
    shade = vec4(mix(horizon, lit, exp(-haze / gl_FragCoord.w)), 1.0);
}
"""

SKY_VERTEX = """
#version 330
void main() {
    vec2 corner = vec2(gl_VertexID == 2 ? 3.0 : -1.0, gl_VertexID == 1 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 1.0, 1.0);
}
"""

SKY_FRAGMENT = """
#version 330
uniform vec3 up;           // slope of the ray through a pixel of the frame buffer: up.x * x + up.y * y + up.z
uniform vec3 horizon;
uniform vec3 zenith;
out vec4 shade;
void main() {
    float slope = dot(up, vec3(gl_FragCoord.xy, 1.0));
    shade = vec4(mix(horizon, zenith, sqrt(clamp(slope, 0.0, 1.0))), 1.0);
}
"""

NOTHING_FRAGMENT = """
#version 330
void main() {}
"""
