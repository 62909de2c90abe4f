import { defineConfig } from "vitest/config";

const server = "http://127.0.0.1:8080";
// The server takes commands from its own page only, and `npm run dev` is a page of another port.
const asItsOwnPage = { target: server, changeOrigin: true, headers: { origin: server } };

export default defineConfig({
  build: {
    outDir: "../server/twinline/api/panel",
    emptyOutDir: true,
    target: "es2022",
    // light-dark() stays as written: the theme is a colour scheme, not two sets of variables.
    cssTarget: ["chrome123", "edge123", "firefox120", "safari17.5"],
    // Everything the page runs is a file of the server, so that a strict content policy holds.
    assetsInlineLimit: 0,
  },
  server: {
    proxy: { "/api": asItsOwnPage, "/view": { ...asItsOwnPage, ws: true } },
  },
  test: { include: ["tests/**/*.test.ts"] },
});
