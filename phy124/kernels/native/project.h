// Projects sixteen Gaussians; view-dependent colours are computed later.
// Python version: `project` of splat/project.py.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

const float LARGEST = 3e38f;
const auto& turn = view.rotation.data;
const float* from = view.translation.c;
const float low = view.low_pass, low_area = view.low_area, focal = view.focal;
const float width = (float)view.width, height = (float)view.height;
const bool keeps_light = view.keeps_light != 0;
const auto clamped = [](float a, float end) { return a < -end ? -end : a > end ? end : a; };
const auto root = [](float a) { return __builtin_elementwise_sqrt(a); };
const auto pixel = [](float edge, float end) {
    return edge > 0.0f ? edge < end ? edge : end : 0.0f;
};
struct Screen {
    float x[16], y[16], shear[16], precision_x[16], precision_y[16], opacity[16], least[16];
    float depth[16], left[16], top[16], right[16], bottom[16];
};
Screen seen;
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
for (int i = 0; i < 16; ++i) {
    const float px = place[3 * i], py = place[3 * i + 1], pz = place[3 * i + 2];
    const float x = turn[0][0] * px + turn[0][1] * py + turn[0][2] * pz + from[0];
    const float y = turn[1][0] * px + turn[1][1] * py + turn[1][2] * pz + from[1];
    const float z = turn[2][0] * px + turn[2][1] * py + turn[2][2] * pz + from[2];
    const float u = clamped(x / z, view.limit[0]), v = clamped(y / z, view.limit[1]);
    const float f = focal / z;
    // Rows of the Jacobian, rotated to world axes.
    const float ax = f * (turn[0][0] - u * turn[2][0]), bx = f * (turn[1][0] - v * turn[2][0]);
    const float ay = f * (turn[0][1] - u * turn[2][1]), by = f * (turn[1][1] - v * turn[2][1]);
    const float az = f * (turn[0][2] - u * turn[2][2]), bz = f * (turn[1][2] - v * turn[2][2]);
    const float w = quat[4 * i], qx = quat[4 * i + 1];
    const float qy = quat[4 * i + 2], qz = quat[4 * i + 3];
    const float norm = w * w + qx * qx + qy * qy + qz * qz;
    const float s = norm > 0.0f ? 2.0f / norm : 0.0f;
    const float xx = 1.0f - s * (qy * qy + qz * qz), yx = s * (qx * qy + w * qz);
    const float zx = s * (qx * qz - w * qy), xy = s * (qx * qy - w * qz);
    const float yy = 1.0f - s * (qx * qx + qz * qz), zy = s * (qy * qz + w * qx);
    const float xz = s * (qx * qz + w * qy), yz = s * (qy * qz - w * qx);
    const float zz = 1.0f - s * (qx * qx + qy * qy);
    const float rx = size[3 * i], ry = size[3 * i + 1], rz = size[3 * i + 2];
    const float a0 = rx * (ax * xx + ay * yx + az * zx);
    const float b0 = rx * (bx * xx + by * yx + bz * zx);
    const float a1 = ry * (ax * xy + ay * yy + az * zy);
    const float b1 = ry * (bx * xy + by * yy + bz * zy);
    const float a2 = rz * (ax * xz + ay * yz + az * zz);
    const float b2 = rz * (bx * xz + by * yz + bz * zz);
    const float aa = a0 * a0 + a1 * a1 + a2 * a2, bb = b0 * b0 + b1 * b1 + b2 * b2;
    const float ab = a0 * b0 + a1 * b1 + a2 * b2;
    // Lagrange's identity gives the determinant as a sum of positive terms, without cancellation.
    const float c0 = a1 * b2 - a2 * b1, c1 = a2 * b0 - a0 * b2, c2 = a0 * b1 - a1 * b0;
    const float area = c0 * c0 + c1 * c1 + c2 * c2;
    const float det = area + low * (aa + bb) + low_area, d = bb + low;
    const float mean_x = f * x + view.centre[0], mean_y = f * y + view.centre[1];
    const float given = opaque[i];
    const float opacity = keeps_light ? given * root(area / det) : given;
    // Any comparison with NaN is false.
    const bool shown = z > view.near && opacity >= MIN_ALPHA && given < LARGEST
        && norm < LARGEST && det < LARGEST
        && mean_x > -LARGEST && mean_x < LARGEST && mean_y > -LARGEST && mean_y < LARGEST;
    const float ratio = shown ? opacity * 255.0f : 1.0f, most = logarithm(ratio);
    const float sigmas = root(most > 0.0f ? 2.0f * most : 0.0f);
    const float reach_x = sigmas * root(aa + low), reach_y = sigmas * root(d);
    seen.x[i] = mean_x;
    seen.y[i] = mean_y;
    seen.shear[i] = ab / d;
    seen.precision_x[i] = d / det;
    seen.precision_y[i] = 1.0f / d;
    seen.opacity[i] = opacity;
    seen.least[i] = -LOG2_E * most;
    seen.depth[i] = z;
    seen.left[i] = pixel(__builtin_elementwise_ceil(mean_x - reach_x - 0.5f), width);
    seen.top[i] = pixel(__builtin_elementwise_ceil(mean_y - reach_y - 0.5f), height);
    const float end_x = __builtin_elementwise_floor(mean_x + reach_x - 0.5f) + 1.0f;
    const float end_y = __builtin_elementwise_floor(mean_y + reach_y - 0.5f) + 1.0f;
    seen.right[i] = shown ? pixel(end_x, width) : -1.0f;
    seen.bottom[i] = pixel(end_y, height);
}

const int across = corners_out.shape[1];
for (int i = 0; i < count; ++i) {
    const int index = begin + i;
    auto& splat = splats_out.data[index];
    auto& tiles = tiles_out.data[index];
    order_out.data[index] = index;
    const int left = (int)seen.left[i], right = (int)seen.right[i];
    const int top = (int)seen.top[i], bottom = (int)seen.bottom[i];
    bool shown = right > left && bottom > top;
    if (shown && degree == 0) {
        const auto& first = sh.data[index * sh.shape[1]];
        float sum = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float colour = 0.5f + C0 * first[c];
            splat.colour[c] = colour > 0.0f ? colour : 0.0f;
            sum += colour;
        }
        shown = sum - sum == 0.0f;
    }
    depths_out.data[index] = shown ? seen.depth[i] : 0.0f;
    if (!shown) {
        for (int k = 0; k < 4; ++k) splat.box[k] = tiles[k] = 0;
        continue;
    }
    splat.mean[0] = seen.x[i];
    splat.mean[1] = seen.y[i];
    splat.shear = seen.shear[i];
    splat.precision_x = seen.precision_x[i];
    splat.precision_y = seen.precision_y[i];
    splat.opacity = seen.opacity[i];
    splat.least = seen.least[i];
    splat.box[0] = left, splat.box[1] = top, splat.box[2] = right, splat.box[3] = bottom;
    tiles[0] = left >> 4, tiles[1] = top >> 4;
    tiles[2] = ((right - 1) >> 4) + 1, tiles[3] = ((bottom - 1) >> 4) + 1;
    int* corners = corners_out.data;
    ++corners[tiles[1] * across + tiles[0]];
    --corners[tiles[1] * across + tiles[2]];
    --corners[tiles[3] * across + tiles[0]];
    ++corners[tiles[3] * across + tiles[2]];
}
