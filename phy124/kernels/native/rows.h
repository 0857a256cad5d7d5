// Loops over rows of nodes that a CPU vectorises. On a GPU, where a thread has one node, only the
// part before the loop does anything.
// Plain form: a loop over nodes.
// Test: tests/test_rows.py, test_wall_momentum_is_summed_over_changed_nodes.

//: copy_row
if (count > 0) wp::array_store(nodes, at, wp::index(others, start));
for (int k = 1; k < count; ++k) nodes.data[at + k] = others.data[start + k];

//: clear_row
for (int k = 0; k < count; ++k) nodes.data[at + k] = {};

//: add_row
auto* sums = &nodes.data[at].c[0];
const auto* more = &others.data[start].c[0];
for (int k = 0; k < 4 * count; ++k) sums[k] += more[k];

//: next_changed
const auto differ = [](const auto& a, const auto& b) {
    return bool((a[0] != b[0]) | (a[1] != b[1]) | (a[2] != b[2]));
};
if (first >= end || differ(wp::index(nodes, at + first), wp::index(others, start + first)))
    return first;
for (int k = first + 1; k < end; ++k)
    if (differ(nodes.data[at + k], others.data[start + k])) return k;
return end;
