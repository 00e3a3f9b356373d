import { defineConfig } from "vite";

// The page goes into the Python package, from which the wheel ships it.
export default defineConfig({
  base: "./",
  build: {
    outDir: "../python/markerloom/studio/page",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 1000,
  },
});
