"""The search of the site keeps states apart whose words contain digits."""

from __future__ import annotations

from pathlib import Path

from docs_build.search import repair_search


def test_the_edges_of_a_state_are_separated_in_its_key(tmp_path: Path) -> None:
    worker = tmp_path / "assets" / "javascripts" / "workers" / "search.0a1b.min.js"
    worker.parent.mkdir(parents=True)
    worker.write_text("for(;i<n;i++){var s=r[i],o=this.edges[s];e=e+s+o.id}return e},t.x=1", encoding="utf-8")
    assert repair_search(tmp_path)
    assert 'e=e+s+o.id+","}return e}' in worker.read_text(encoding="utf-8")
    assert not repair_search(tmp_path), "a worker that does not join them is left alone"
