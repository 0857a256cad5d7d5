"""Writes docs/lab/index.md: program, date and commit of each table of the lab, from the history.

`python tests/benchmarks/provenance.py` measures nothing.
"""

import re
import subprocess
from collections import Counter
from datetime import datetime, timezone
from pathlib import Path

from tables import DOCS, markdown

PROGRAM = re.compile(
    r"`(?:[^`\n]*\bpython\n|[^`\n]*?)"
    r"(tests/benchmarks/\w+(?:\.py)?|tests/test_\w+\.py|phy124 [a-z]+|make [a-z-]+)"
)
MACHINE = "2 cores of an AMD EPYC"
HEAD = f"""# The lab

These pages contain all measurements, with machine, date and version. The
[results](../results/accuracy.md) are short summaries of these pages. Unless a page names another
machine, the tables were measured on a virtual machine with {MACHINE} and no GPU.

*Commit* is the version of phy124 in which the numbers of a table were last changed, and *date* is
the day of that commit. `python tests/benchmarks/provenance.py` writes this page.

"""


def read_commits(page: Path) -> list[tuple[str, str, str]]:
    """Return commit, date and text of each line of a page."""
    command = ["git", "blame", "-w", "-M", "-C", "-C", "--date=short", "--line-porcelain", page]
    output = subprocess.run(command, capture_output=True, text=True, check=True, cwd=DOCS).stdout
    lines, commit, date = [], "", ""
    for line in output.splitlines():
        if re.match(r"[0-9a-f]{40} ", line):
            commit = line[:8]
        elif line.startswith("author-time "):
            date = line.split()[1]
        elif line.startswith("\t"):
            lines.append((commit, date, line[1:]))
    return lines


def make_anchor(heading: str) -> str:
    """Return the anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def list_tables(page: Path) -> list[list[str]]:
    """Return section, program, date and commit of each section that has a table."""
    rows, title, section, text, cells = [], "", "", "", []
    for commit, stamp, line in [*read_commits(page), ("", "0", "# ")]:
        if line.startswith("#"):
            if len(cells) > 2:
                (commit, stamp), _ = Counter(cells).most_common(1)[0]
                match = PROGRAM.search(text) or PROGRAM.search(title)
                day = datetime.fromtimestamp(int(stamp), timezone.utc).date()
                link = f"[{section.replace('`', '')}]({page.name}#{make_anchor(section)})"
                rows.append([link, f"`{match[1]}`" if match else "", str(day), f"`{commit}`"])
            section = line.lstrip("# ")
            text = ""
            cells = []
        elif line.startswith("|"):
            cells.append((commit, stamp))
        else:
            text += line + "\n"
            title += line + "\n"
    return rows


if __name__ == "__main__":
    pages = sorted((DOCS / "lab").glob("*.md"))
    rows = [row for page in pages if page.stem != "index" for row in list_tables(page)]
    table = markdown(["measured", "program", "date", "commit"], rows)
    (DOCS / "lab/index.md").write_text(f"{HEAD}{table}\n", "utf-8")
