// Fails if the committed bundle differs from the one that the source builds: node check.mjs.
import { execFileSync } from "node:child_process";
import { mkdtempSync, readdirSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const committed = join(here, "../src/splatreel/play/static");
const fresh = mkdtempSync(join(tmpdir(), "splatreel-player-"));
try {
  execFileSync(process.execPath, [join(here, "build.mjs"), fresh], { stdio: "inherit" });
  const names = [...new Set([...readdirSync(committed), ...readdirSync(fresh)])].sort();
  const read = (folder, name) =>
    readdirSync(folder).includes(name) ? readFileSync(join(folder, name)) : Buffer.from("missing");
  const different = names.filter((name) => !read(committed, name).equals(read(fresh, name)));
  if (different.length > 0) {
    console.error(
      `The committed player differs from its source: ${different.join(", ")}. Run \`make player\` and commit the result.`,
    );
    process.exitCode = 1;
  } else console.log(`The committed player equals the one that its source builds (${names.length} files).`);
} finally {
  rmSync(fresh, { recursive: true });
}
