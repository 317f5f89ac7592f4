// One self-contained page: script and style inlined, and the SHA-256 of the sources in a meta element.
import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { join, dirname } from "node:path";
import { fileURLToPath } from "node:url";
import { defineConfig } from "vite";

const ROOT = dirname(fileURLToPath(import.meta.url));

/** SHA-256 over names and contents of all that the page is built from, in order of name. */
function sourceDigest() {
  const names = [
    "index.html",
    "package.json",
    "package-lock.json",
    "vite.config.js",
    ...readdirSync(join(ROOT, "src")).map((name) => `src/${name}`),
  ].sort();
  const digest = createHash("sha256");
  for (const name of names) {
    digest.update(`${name}\n`);
    digest.update(readFileSync(join(ROOT, name)));
  }
  return digest.digest("hex");
}

function inlined() {
  return {
    name: "one-file",
    enforce: "post",
    generateBundle(_, bundle) {
      const page = bundle["index.html"];
      const scripts = Object.values(bundle).filter((one) => one.type === "chunk");
      const styles = Object.values(bundle).filter((one) => one.fileName.endsWith(".css"));
      let html = page.source.replace(/<script type="module"[^>]*src=[^>]*><\/script>\s*/g, "");
      html = html.replace(/<link rel="stylesheet"[^>]*>\s*/g, "");
      const style = styles.map((one) => one.source).join("\n");
      const code = scripts.map((one) => one.code).join("\n").replaceAll("</script", "<\\/script");
      const meta = `<meta name="dvf-sources" content="${sourceDigest()}" />`;
      html = html.replace("</head>", () => `${meta}\n<style>${style}</style>\n</head>`);
      html = html.replace("</body>", () => `<script type="module">${code}</script>\n</body>`);
      for (const one of [...scripts, ...styles]) delete bundle[one.fileName];
      page.fileName = "viewer.html";
      page.source = html;
    },
  };
}

export default defineConfig({
  root: ROOT,
  base: "./",
  plugins: [inlined()],
  build: {
    outDir: "built",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: false,
    assetsInlineLimit: 100000000,
    cssCodeSplit: false,
    reportCompressedSize: false,
    chunkSizeWarningLimit: 2000,
  },
});
