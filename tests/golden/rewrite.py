"""``make golden``: write the golden files anew.  Review the difference."""

from __future__ import annotations

import shutil

from tests.golden.outputs import EXAMPLES, GOLDEN, expected_files, made_files


def main() -> None:
    for folder in sorted(path for path in GOLDEN.iterdir() if path.is_dir()):
        if folder.name not in EXAMPLES and folder.name != "__pycache__":
            shutil.rmtree(folder)
    for example in EXAMPLES:
        made, before = made_files(example), expected_files(example)
        changed = [path for path in made if before.get(path) != made[path]]
        gone = [path for path in before if path not in made]
        for path in gone:
            (GOLDEN / example / path).unlink()
        for path in changed:
            file = GOLDEN / example / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(made[path].encode())
        print(f"{example}: {len(changed)} of {len(made)} files rewritten, {len(gone)} removed")


if __name__ == "__main__":
    main()
