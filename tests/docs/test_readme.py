"""README is shown on package indexes too, where a relative address leads nowhere."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
REPOSITORY = re.compile(
    r"https://(?:raw\.githubusercontent\.com/skfem-joint/skfem-joint/"
    r"|github\.com/skfem-joint/skfem-joint/(?:blob|raw|tree)/)main/(.+)"
)


def addresses(text: str) -> list[str]:
    """Targets of all links and pictures outside code blocks, without what follows a ``#``."""
    text = re.sub(r"^(`{3,}).*?^\1$", "", text, flags=re.DOTALL | re.MULTILINE)
    found = re.findall(r"\]\(\s*<?([^)\s>]+)", text)
    found += re.findall(r"^\[[^\]]+\]:\s*<?([^\s>]+)", text, re.MULTILINE)
    found += re.findall(r"\b(?:src|srcset|href)\s*=\s*[\"']([^\"']+)", text)
    return [target.partition("#")[0] for target in found if not target.startswith("#")]


def test_all_kinds_of_addresses_are_found():
    text = """[a](b.md#c) ![d](e.png "f") [g](<h.md>) [i](#j) <img src="k.png"> [l][m]
[m]: n.md
```
[o](p.md)
```
<a href='q.md'>"""
    assert addresses(text) == ["b.md", "e.png", "h.md", "n.md", "k.png", "q.md"]


def test_no_address_is_relative_and_those_in_the_repository_exist():
    targets = addresses((ROOT / "README.md").read_text(encoding="utf-8"))
    assert targets
    assert [target for target in targets if not target.startswith("https://")] == []
    named = [match[1] for target in targets if (match := REPOSITORY.fullmatch(target))]
    assert [path for path in named if not (ROOT / path).exists()] == []
