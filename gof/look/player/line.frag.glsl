#version 300 es
precision highp float;

in vec4 paint;
out vec4 light;

void main() {
  light = paint;
}
