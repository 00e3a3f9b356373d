// Colours: kinds in tones that the colour-blind tell apart (Okabe and Ito 2008), markers by their set or by a fixed order.

export const KIND_COLORS = ["#3d8fd1", "#e69f00", "#1aa67d", "#d67cb1"];
export const FINDING_COLORS: Record<string, string> = {
  gap: "#e69f00",
  residual: "#d55e00",
  jump: "#d55e00",
  name: "#cc79a7",
  unlabelled: "#9aa5b1",
};
const PALETTE = ["#56b4e9", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#8fb8de", "#b8d977"];

export const markerColor = (color: string, label: string, slot: number): string =>
  color || (label ? PALETTE[slot % PALETTE.length] : "#9aa5b1");

/** From good (blue) over middling to bad (vermilion): dark to light, so that it reads without colour, too. */
export function heat(share: number): string {
  const t = Math.min(Math.max(share, 0), 1);
  const stops = [
    [38, 84, 150],
    [86, 180, 233],
    [240, 228, 66],
    [213, 94, 0],
  ];
  const at = t * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2);
  const mix = stops[i].map((v, k) => Math.round(v + (at - i) * (stops[i + 1][k] - v)));
  return `rgb(${mix.join(",")})`;
}

/** A colour as CSS has it in the page's present theme. */
export const css = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export type Theme = "light" | "dark";

export function applyTheme(theme: Theme | null): Theme {
  const wanted = theme ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");
  document.documentElement.dataset.theme = wanted;
  return wanted;
}
