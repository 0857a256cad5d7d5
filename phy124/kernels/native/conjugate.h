// Loops of conjugate gradients over a part of the listed cells, in float64. Access by pointers, since
// the access to arrays with variable strides takes several times as long as the arithmetic.
// Python version: `factorise`, `precondition`, `turn` and `descend` of liquid/conjugate.py.
// Test: tests/test_liquid.py, test_native_and_plain_conjugate_gradients_agree.

const int* const cell = listed.data;

//: factorise
const double* const link = (const double*)links.data;
const long next[3] = {layer, row, 1};
const int lowest = cell[first];
double* const p = inverse.data;
for (int k = first; k < last; ++k) {
    const long n = cell[k];
    double e = diagonal.data[n];
    for (int axis = 0; axis < 3; ++axis) {
        const long m = n - next[axis];
        if (m < lowest) continue;
        const double* const l = link + 3 * m;
        const double here = l[axis], others = l[0] + l[1] + l[2] - here, pp = p[m] * p[m];
        e -= here * here * pp + TUNING * here * others * pp;
    }
    if (e < SAFETY * diagonal.data[n]) e = diagonal.data[n];
    p[n] = 1.0 / wp::sqrt(e);
}

//: precondition
const double* const link = (const double*)links.data;
const int lowest = cell[first], highest = cell[last - 1];
const double* const p = inverse.data;
const double* const r = residual.data;
double* const to = z.data;
for (int k = first; k < last; ++k) {
    const long n = cell[k], x = n - layer, y = n - row;
    double value = r[n];
    if (n - 1 >= lowest) value -= link[3 * n - 1] * p[n - 1] * to[n - 1];
    if (y >= lowest) value -= link[3 * y + 1] * p[y] * to[y];
    if (x >= lowest) value -= link[3 * x] * p[x] * to[x];
    to[n] = p[n] * value;
}
for (int k = last - 1; k >= first; --k) {
    const long n = cell[k];
    const double* const l = link + 3 * n;
    double value = to[n];
    if (n + 1 <= highest) value -= p[n] * l[2] * to[n + 1];
    if (n + row <= highest) value -= p[n] * l[1] * to[n + row];
    if (n + layer <= highest) value -= p[n] * l[0] * to[n + layer];
    to[n] = p[n] * value;
}
double product = 0.0;
for (int k = first; k < last; ++k) product += r[cell[k]] * to[cell[k]];
return product;

//: turn
const double* const link = (const double*)links.data;
const double* const from = z.data;
const double* const s = before.data;
const auto turned = [&](long n) { return from[n] + beta * s[n]; };
double steep = 0.0;
for (int k = first; k < last; ++k) {
    const long n = cell[k], x = n - layer, y = n - row;
    const double here = turned(n);
    double value = link[3 * x] * turned(x);
    value += link[3 * y + 1] * turned(y);
    value += link[3 * n - 1] * turned(n - 1);
    value += link[3 * n] * turned(n + layer);
    value += link[3 * n + 1] * turned(n + row);
    value += link[3 * n + 2] * turned(n + 1);
    value += diagonal.data[n] * here;
    direction.data[n] = here;
    product.data[n] = value;
    steep += here * value;
}
return steep;

//: descend
double* const r = residual.data;
double largest = 0.0;
for (int k = first; k < last; ++k) {
    const long n = cell[k];
    x.data[n] += alpha * direction.data[n];
    r[n] -= alpha * product.data[n];
    largest = wp::max(largest, wp::abs(r[n]));
}
return largest;
