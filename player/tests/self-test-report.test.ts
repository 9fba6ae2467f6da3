import assert from "node:assert/strict";
import { test } from "node:test";
import { megabytes, quantile, reportOf, spreadOf } from "../packages/element/src/self-test/report";

test("quantiles interpolate between the sorted values", () => {
  assert.deepEqual(
    [0, 0.5, 0.75, 1].map((part) => quantile([4, 1, 3, 2], part)),
    [1, 2.5, 3.25, 4],
  );
  assert.equal(quantile([7], 0.95), 7);
  assert.equal(spreadOf(Array.from({ length: 101 }, (_, i) => 100 - i)), "median 50.0 ms, 95th percentile 95.0 ms");
  assert.deepEqual([spreadOf([]), megabytes(12_345_678)], ["none", "12.3 MB"]);
});

test("a result is a table of Markdown, whose cells no text can leave", () => {
  const report = reportOf("1.2.3", [
    { name: "Drag", state: "passed", text: "turned the view" },
    { name: "Pinch", state: "skipped", text: "" },
    { name: "Browser", state: "fact", text: "a | b\n| c <img>" },
  ]);
  assert.deepEqual(report.split("\n"), [
    "### Self-test of Splatreel's player 1.2.3",
    "",
    "| test | result |",
    "|---|---|",
    "| Drag | passed: turned the view |",
    "| Pinch | skipped |",
    "| Browser | a \\| b \\| c \\<img> |",
    "",
  ]);
});
