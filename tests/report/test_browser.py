"""The page in a real browser, where one is installed: as people use it."""

import pytest

from specmap_cli.maps.store import Map
from tests.report.browser import Browser


def chosen(browser: Browser) -> list[str]:
    """The submaps whose sheets are seen."""
    found = browser.run(
        "all('.sheet').filter((each) => each.offsetHeight > 0).map((each) => each.dataset.submap)"
    )
    return [str(each) for each in found]


def middle(browser: Browser, selector: str) -> tuple[float, float]:
    box = browser.run(
        f"(b => [b.x + b.width / 2, b.y + b.height / 2])(one({selector!r}).getBoundingClientRect())"
    )
    return float(box[0]), float(box[1])


def test_it_opens_and_every_layer_is_drawn_and_hides(browser: Browser) -> None:
    assert browser.run("document.title").endswith("specmap report")
    names = browser.run("all('[data-shows]').map((box) => box.dataset.shows)")
    assert {"regions", "walls", "badges", "doors", "ways", "track"} <= set(names)
    for name in names:
        selector = f"[data-layer={name}]" if name != "regions" else "#regions:not(.plain-ground)"
        shown = f"all({selector!r}).some((each) => each.getBoundingClientRect().width > 0)"
        browser.run(f"showLayer({name!r}, true)")
        assert browser.run(shown), name
        browser.run(f"one('[data-shows={name}]').click()")
        assert not browser.run(shown), name


def test_map_table_and_address_choose_and_show_one_submap(browser: Browser) -> None:
    assert chosen(browser) == []
    browser.click(*middle(browser, ".badge[data-submap='1']"))
    assert chosen(browser) == ["1"]
    assert browser.run("location.hash") == "#submap-1"
    assert browser.run("one('tr.chosen').dataset.submap") == "1"
    assert browser.run("one('.region.chosen').getAttribute('aria-pressed')") == "true"
    browser.run("one('#sheet-1 [data-close]').click()")
    assert chosen(browser) == []
    browser.run("one('tbody tr[data-submap=\"2\"] td').click()")
    assert chosen(browser) == ["2"]
    over = "new PointerEvent('pointerover', {bubbles: true})"
    browser.run(f"one('tr[data-submap=\"0\"]').dispatchEvent({over})")
    assert browser.run("one('.region.near').dataset.submap") == "0"
    for address in ("1", "999"):  # which there is not
        hashed = f"location.hash = '#submap-{address}'"
        browser.run(f"{hashed}; new Promise((done) => setTimeout(done, 50))")
        assert chosen(browser) == ["1"]


def test_names_on_the_map_do_not_lie_on_one_another(browser: Browser) -> None:
    """Of two that would the first is shown, and the one that is chosen."""
    label = "document.createElementNS('http://www.w3.org/2000/svg', 'text')"
    browser.run(
        "all('.badge .name').forEach((each) => each.remove());"
        f"all('.badge').forEach((badge) => {{ const name = {label};"
        "name.classList.add('name'); name.setAttribute('y', 22);"
        "name.textContent = 'a long name '.repeat(9); badge.append(name); });"
        "redraw()"
    )
    shown = (
        "all('.badge .name').filter((each) => getComputedStyle(each).visibility === 'visible')"
        ".map((each) => each.parentNode.dataset.submap)"
    )
    count = browser.run("all('.badge').length")
    before = browser.run(shown)
    assert 0 < len(before) < count
    hidden = next(each for each in map(str, range(count)) if each not in before)
    browser.click(*middle(browser, f".badge[data-submap='{hidden}'] circle"))
    assert hidden in browser.run(shown)


def test_the_table_sorts_both_ways(browser: Browser, flat_map: Map) -> None:
    areas = {str(node.id): node.area_m2 for node in flat_map.record.nodes}
    press = "all('#submaps thead button')[3].click()"
    rows = "all('#submaps tbody tr').map((row) => row.dataset.submap)"
    browser.run(press)
    assert browser.run(rows) == sorted(areas, key=lambda id_: areas[id_])
    browser.run(press)
    assert browser.run(rows) == sorted(areas, key=lambda id_: -areas[id_])
    assert browser.run("all('#submaps th')[3].getAttribute('aria-sort')") == "descending"


def test_the_slider_moves_the_robot_to_where_it_was(browser: Browser, flat_map: Map) -> None:
    stamps, poses = flat_map.labels.stamps_ns, flat_map.labels.poses
    places = [middle(browser, "#robot path")]  # where it began
    left, top = browser.run("[placeAt(0).x, placeAt(0).y]")
    for row in (len(stamps) // 3, len(stamps) // 2):
        browser.run(f"slider.value = {(stamps[row] - stamps[0]) / 1e9}")
        browser.run("slider.dispatchEvent(new Event('input'))")
        places.append(middle(browser, "#robot path"))
        at = (browser.run(f"parseFloat(robot.style.getPropertyValue('--{k}'))") for k in "xy")
        x, y = map(float, at)
        moved = poses[row, :2] - poses[0, :2]
        assert (x - left, top - y) == pytest.approx((100 * moved).tolist(), abs=8.0)
        name = f"submap {flat_map.labels.submaps[row]}"
        assert name in browser.run("one('#readout').textContent")
        assert name in browser.run("slider.getAttribute('aria-valuetext')")
    assert len(set(places)) == 3


def test_it_plays_and_stops(browser: Browser) -> None:
    browser.prefers(reduced_motion="no-preference")
    browser.run("one('#play').click()")
    browser.run("new Promise((done) => setTimeout(done, 300))")
    assert float(browser.run("slider.value")) > 0.0
    browser.run("one('#play').click()")
    stopped = browser.run("slider.value")
    browser.run("new Promise((done) => setTimeout(done, 100))")
    assert browser.run("slider.value") == stopped


def test_the_keyboard_does_all(browser: Browser) -> None:
    browser.run("map.focus()")
    browser.press("ArrowRight")
    first = browser.run("document.activeElement.dataset.submap")
    browser.press("ArrowRight")
    second = browser.run("document.activeElement.dataset.submap")
    browser.press("ArrowLeft")
    browser.press("ArrowUp")
    assert None not in (first, second)
    browser.press("Enter")
    assert chosen(browser) == [browser.run("document.activeElement.dataset.submap")]
    browser.press("+")
    assert browser.run("view.width < wholeView().width")
    before = browser.run("view.x")
    browser.press("ArrowRight", shift=True)
    assert browser.run("view.x") > before
    browser.press("0")
    assert browser.run("stillFits")
    browser.press("Escape")
    assert chosen(browser) == []
    browser.run("slider.focus()")
    browser.press("End")
    assert browser.run("slider.value") == browser.run("slider.max")
    reached = browser.run(
        """(() => { const seen = new Set(), open = [regions.keys().next().value];
        while (open.length) { const id = open.pop(); if (id === null || seen.has(id)) continue;
        seen.add(id); for (const way of Object.values(WAYS)) open.push(nextTo(id, way)); }
        return seen.size === regions.size; })()"""
    )
    assert reached, "arrows lead to every submap"


def test_dragging_moves_the_map_and_chooses_nothing(browser: Browser) -> None:
    browser.run("zoomBy(3)")
    x, y = middle(browser, "#stage")
    before = browser.run("view.x")
    browser.mouse("mouseMoved", x, y)
    browser.mouse("mousePressed", x, y)
    browser.mouse("mouseMoved", x - 80, y - 20, buttons=1, button="left")
    browser.mouse("mouseMoved", x - 120, y - 20, buttons=1, button="left")
    browser.mouse("mouseReleased", x - 120, y - 20)
    assert browser.run("view.x") > before
    assert chosen(browser) == []


def test_two_fingers_zoom(browser: Browser) -> None:
    browser.size(390, 844, phone=True)
    x, y = middle(browser, "#stage")
    before = browser.run("view.width")
    browser.touch("touchStart", (x - 20, y), (x + 20, y))
    for apart in (30, 50, 70):
        browser.touch("touchMove", (x - apart, y), (x + apart, y))
    browser.touch("touchEnd")
    assert browser.run("view.width") < 0.75 * before
    assert chosen(browser) == []


def test_split_tests_show_their_spectrum_and_their_nodes(browser: Browser) -> None:
    bars = browser.run("one('#spectrum').childElementCount")
    assert bars > 1
    words = browser.run("one('#test-words').textContent")
    browser.run("one('#tests').focus()")
    browser.press("ArrowRight")
    assert browser.run("one('#test-words').textContent") != words
    browser.run("one('#test-on-map').click()")
    assert browser.run("all('#test-nodes circle').length") > 3
    browser.run("one('#test-on-map').click()")
    assert browser.run("all('#test-nodes circle').length") == 0


@pytest.mark.parametrize("size", [(320, 800), (390, 844), (820, 1180), (1280, 900), (1920, 1080)])
def test_it_fits_any_screen_from_side_to_side(browser: Browser, size: tuple[int, int]) -> None:
    browser.size(*size, phone=size[0] < 400)
    low = "one('#time').getBoundingClientRect().bottom"
    assert browser.run(f"{low} - stage.getBoundingClientRect().top") < size[1]
    assert browser.run("stage.clientHeight") > 200
    for _ in range(2):
        assert browser.run("document.documentElement.scrollWidth") <= size[0]
        browser.run("choose('1')")


def test_day_and_night(browser: Browser) -> None:
    ground = "getComputedStyle(document.body).backgroundColor"
    day = browser.run(ground)
    browser.prefers(color_scheme="dark")
    assert browser.run(ground) != day
    browser.run("one('#theme').click()")
    assert browser.run(ground) == day


def test_on_paper_are_all_submaps_and_no_buttons(browser: Browser, flat_map: Map) -> None:
    browser.run("choose('1'); zoomBy(4)")
    browser.prefers(media="print", color_scheme="dark")
    assert sorted(map(int, chosen(browser))) == flat_map.ids
    assert browser.run("one('.zoom').offsetHeight") == 0
    assert browser.run("one('#playback').offsetHeight") == 0
    browser.prefers(color_scheme="light")
    assert browser.paper().startswith(b"%PDF")
