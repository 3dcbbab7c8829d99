// Which YAML documents are documents of thorvaldc.  Other YAML files, such as a robot.yaml of another
// tool, keep their language.
"use strict";

const NAMES = ["robot.yaml", "fleet.yaml", "module.yaml", "scenario.yaml", "calibration.yaml"];
const MAX_COMMENT_LINES = 50;

/** Whether the first line of a text that is no comment is `thorvaldc: 1`, or an empty file has one of
 * the names of the language.
 * @param {string} fileName name without folders
 * @param {(line: number) => string} lineAt
 * @param {number} lineCount
 */
function isOurs(fileName, lineAt, lineCount) {
  for (let line = 0; line < Math.min(lineCount, MAX_COMMENT_LINES); line++) {
    const text = lineAt(line).replace(/^\uFEFF/, "").trim();
    if (text === "" || text === "---" || text.startsWith("#")) {
      continue;
    }
    return /^["']?thorvaldc["']?\s*:/.test(text);
  }
  return lineCount <= MAX_COMMENT_LINES && NAMES.includes(fileName);
}

module.exports = { isOurs };
