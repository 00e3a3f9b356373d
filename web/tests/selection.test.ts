import { describe, expect, it } from "vitest";
import { chosen, main, neighbour, other, remaining } from "../src/selection";

describe("the selection", () => {
  it("holds one, or several with a key held down", () => {
    expect(chosen([], 3, false)).toEqual([3]);
    expect(chosen([3], 5, true)).toEqual([3, 5]);
    expect(chosen([3, 5], 3, true)).toEqual([5]);
    expect(chosen([3, 5], 7, false)).toEqual([7]);
    const same = [3];
    expect(chosen(same, 3, false)).toBe(same);
  });

  it("knows who is spoken of, and the other of a pair", () => {
    expect([main([]), main([4]), main([4, 6])]).toEqual([null, 4, 6]);
    expect([other([4]), other([4, 6]), other([4, 6, 8])]).toEqual([null, 4, null]);
  });

  it("goes through the markers in order and around", () => {
    expect(neighbour([], [2, 5, 9], 1)).toEqual([2]);
    expect(neighbour([], [2, 5, 9], -1)).toEqual([9]);
    expect(neighbour([9], [2, 5, 9], 1)).toEqual([2]);
    expect(neighbour([2], [2, 5, 9], -1)).toEqual([9]);
    expect(neighbour([], [], 1)).toEqual([]);
  });

  it("loses what is gone", () => {
    expect(remaining([1, 2, 3], new Set([1, 3]))).toEqual([1, 3]);
    const same = [1, 3];
    expect(remaining(same, new Set([1, 3]))).toBe(same);
  });
});
