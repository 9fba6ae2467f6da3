import assert from "node:assert/strict";
import { test } from "node:test";
import { BandwidthMeter } from "../packages/decoder/src/stream/decoder-pool";

const near = (value: number, expected: number): void =>
  assert.ok(Math.abs(value / expected - 1) < 0.01, `${value} is not ${expected}`);

test("the rate is 0 before the first transfer", () => assert.equal(new BandwidthMeter().rate, 0));

test("concurrent transfers share the bandwidth", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.begin(0);
  for (let now = 100; now <= 1000; now += 100) {
    meter.addBytes(25_000, now);
    meter.addBytes(25_000, now);
  }
  near(meter.rate, 4e6);
});

test("idle time does not count; waiting for the first byte does", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.addBytes(50_000, 400);
  meter.end(400);
  meter.begin(5000);
  meter.addBytes(50_000, 5400);
  near(meter.rate, 1e6);
});

test("old transfers are forgotten", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  let now = 0;
  for (let i = 0; i < 20; i++) meter.addBytes(125_000, (now += 1000));
  near(meter.rate, 1e6);
  for (let i = 0; i < 5; i++) meter.addBytes(125_000, (now += 100));
  near(meter.rate, 1e7);
});

test("the estimate rises while the line is idle", () => {
  const meter = new BandwidthMeter();
  meter.begin(0);
  meter.addBytes(125_000, 1000);
  meter.end(1000);
  near(meter.optimisticRate(1000), 1e6);
  near(meter.optimisticRate(11_000), 4e6);
  meter.begin(20_000);
  assert.equal(meter.optimisticRate(21_000), meter.rate);
  meter.addBytes(125_000, 20_100);
  near(meter.rate, 1e7);
});
