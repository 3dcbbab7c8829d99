// Compiles the Python files of a folder for the Python of Pyodide, and packs them with the other
// files in a zip archive: node pack.mjs FOLDER ARCHIVE
import { writeFileSync } from "node:fs";
import { loadPyodide } from "pyodide";

const [folder, archive] = process.argv.slice(2);
// Python without the columns of instructions, which only tracebacks show: a quarter of the size.
const python = await loadPyodide({ env: { PYTHONNODEBUGRANGES: "1", HOME: "/" } });
python.FS.mkdir("/source");
python.FS.mount(python.FS.filesystems.NODEFS, { root: folder }, "/source");
// Without checks of times, docstrings and assertions; with the same date in each archive.
python.runPython(`
import py_compile, zipfile
from pathlib import Path

def pack(folder, archive):
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
        for path in sorted(folder.rglob("*")):
            name, data = path.relative_to(folder).as_posix(), None
            if path.is_file() and path.suffix == ".py" and "_data" not in path.parts: # no templates
                mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
                py_compile.compile(path, "/compiled", "/" + name, True, 2, mode)
                name, data = name + "c", Path("/compiled").read_bytes()
            elif path.is_file():
                data = path.read_bytes()
            if data is not None:
                packed.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)

pack(Path("/source"), "/archive.zip")
`);
writeFileSync(archive, python.FS.readFile("/archive.zip"));
