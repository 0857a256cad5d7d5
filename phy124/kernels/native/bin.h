// Appends every splat, front to back, to the lists of the tiles that it touches.
// Plain form: `bin_parallel` of splat/bin.py, whose lists are then sorted.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

int* __restrict slots = ends_out.data;
int* __restrict lists = pairs_out.data;
const auto* __restrict boxes = tiles.data;
const int* __restrict sorted = order.data;
for (int k = 0; k < count; ++k) {
    // Splats lie anywhere in memory: fetch one that comes soon.
    if (k + 16 < count) __builtin_prefetch(&boxes[sorted[k + 16]]);
    const int i = sorted[k];
    const auto box = boxes[i];
    for (int row = box[1]; row < box[3]; ++row)
        for (int tile = row * columns + box[0]; tile < row * columns + box[2]; ++tile)
            if (tile >= first && tile < last) lists[slots[tile]++] = i;
}
