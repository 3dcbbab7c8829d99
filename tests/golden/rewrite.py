"""``make golden``: rewrites the golden files.  Review the differences."""

from __future__ import annotations

import shutil

from tests.golden.outputs import EXAMPLES, GOLDEN, SUMS, current_files, expected_files


def main() -> None:
    for folder in sorted(path for path in GOLDEN.iterdir() if path.is_dir()):
        if folder.name not in EXAMPLES and folder.name != "__pycache__":
            shutil.rmtree(folder)
    lists, report = [], []
    for example in EXAMPLES:
        (current, sums), golden = current_files(example), expected_files(example)
        lists.append(sums)
        changed = [path for path in current if golden.get(path) != current[path]]
        obsolete = [path for path in golden if path not in current]
        for path in obsolete:
            (GOLDEN / example / path).unlink()
        for path in changed:
            file = GOLDEN / example / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(current[path].encode())
        report.append(
            f"{example}: {len(changed)} of {len(current)} files rewritten, {len(obsolete)} removed"
        )
    SUMS.write_text("".join(lists), encoding="utf-8", newline="\n")
    print("\n".join(report))  # after the work, which a closed pipe would end


if __name__ == "__main__":
    main()
