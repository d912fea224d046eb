"""The page for the field: its scenario is one that a fleet takes."""

from pathlib import Path

from ptnsbc_sim.scenario import load_scenario

PAGE = Path(__file__).parents[2] / "docs" / "field.md"


def test_the_fleet_of_the_page_is_a_scenario_with_the_links_that_it_names(tmp_path):
    _, _, rest = PAGE.read_text("utf-8").partition("```yaml\n")
    path = tmp_path / "fleet.yaml"
    path.write_text(rest.partition("```")[0], encoding="utf-8")
    fleet = load_scenario(str(path)).bridged()
    links = [fleet.vehicle_link(uav) for uav in fleet.uav_ids]
    assert [link.sysid for link in links] == [11, 12, 13, 14]
    assert [link.connect.partition(":")[0] for link in links] == [
        "udpin", "udpout", "serial", "udpin"
    ]  # fmt: skip
    assert links[3].autopilot == "ardupilot"
