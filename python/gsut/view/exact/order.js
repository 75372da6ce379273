// Orders the Gaussians by their distance from the eye, in a thread of its own: a counting sort.
"use strict";
// A number of Gaussians of which the order's length is a multiple: TABLE_WIDTH of moving.js.
const ROW = 2048;
let means, distances, bits;

onmessage = ({ data }) => {
  if (data.means) {
    ({ means } = data);
    distances = new Float32Array(means.length / 3);
    bits = new Uint32Array(distances.buffer); // of a float that is not negative: they ascend with it
    return;
  }
  const [x, y, z] = data.center, size = distances.length, keys = new Uint16Array(size), begin = new Uint32Array(65537), order = new Uint32Array(ROW * Math.ceil(size / ROW));
  let low = 0xffffffff, high = 0;
  for (let i = 0; i < size; i++) {
    const dx = means[3 * i] - x, dy = means[3 * i + 1] - y, dz = means[3 * i + 2] - z;
    distances[i] = dx * dx + dy * dy + dz * dz;
    low = Math.min(low, bits[i]);
    high = Math.max(high, bits[i]);
  }
  const step = 65535 / Math.max(1, high - low);
  for (let i = 0; i < size; i++) {
    keys[i] = (bits[i] - low) * step;
    begin[keys[i] + 1]++;
  }
  for (let k = 0; k < 65536; k++) begin[k + 1] += begin[k];
  for (let i = 0; i < size; i++) order[begin[keys[i]]++] = i;
  postMessage(order, [order.buffer]);
};
