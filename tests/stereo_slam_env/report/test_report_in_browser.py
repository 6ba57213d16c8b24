"""The report in a real browser: opened from a file, used, printed, without an error or a request (about 15 s)."""

import pytest

from .browsing import PATIENCE, Visit

pytestmark = pytest.mark.slow

SCREENS = [(1366, 768), (1280, 800)]


@pytest.fixture(scope="module")
def path(report_of_five):
    return report_of_five


@pytest.fixture(scope="module")
def opened(browser, path):
    visit = Visit(browser, path)
    visit.see_everything()
    yield visit
    visit.page.close()


@pytest.fixture
def visit(opened):
    """The page with all its charts drawn, in a light window whatever the test before made of it."""
    opened.page.emulate_media(media="screen", color_scheme="light")
    opened.page.set_viewport_size({"width": 1366, "height": 768})
    return opened


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_the_first_screen_holds_headline_and_answers(visit, five_filters, width, height):
    visit.page.set_viewport_size({"width": width, "height": height})
    visit.value("scrollTo(0, 0)")
    boxes = visit.value(
        """[...document.querySelectorAll("h1, .headline, .answers th, .answers td")]
            .map(part => part.getBoundingClientRect()).map(({right, bottom}) => [right, bottom])"""
    )
    assert len(boxes) == 2 + 6 + len(five_filters) * 6
    assert max(right for right, _ in boxes) <= width
    assert max(bottom for _, bottom in boxes) <= height
    assert not visit.is_wider_than_the_window()


def test_every_chart_is_drawn_without_a_complaint_or_a_request(visit, path):
    assert visit.value("document.querySelectorAll('figure.live .chart svg').length") == 19
    assert visit.complaints == []
    assert visit.requests == [path.as_uri()]


def test_a_table_sorts_by_click_and_by_key(visit):
    names = "[...document.querySelectorAll('.answers tbody th')].map(head => head.dataset.value)"
    values = "[...document.querySelectorAll('.answers tbody tr')].map(row => Number(row.cells[1].dataset.value))"
    head = visit.page.locator(".answers thead th").nth(1)
    head.locator("button").click()
    assert visit.value(values) == sorted(visit.value(values))
    assert head.get_attribute("aria-sort") == "ascending"
    first = visit.value(names)
    head.locator("button").press("Enter")
    assert head.get_attribute("aria-sort") == "descending"
    assert visit.value(names) == first[::-1]


DRAWN = """[...document.querySelectorAll("#figure-velocity .chart svg path")]
    .filter(path => path.getAttribute("stroke") === "var(--series-2)" && path.getAttribute("d").length > 200).length"""
NAMED = "[...document.querySelectorAll('#figure-velocity .chart svg text')].some(t => t.textContent === 'euclidean')"


def wait_until(visit, drawn, named):
    """Vega draws when it comes to it."""
    visit.page.wait_for_function(f"{DRAWN} === {drawn} && {NAMED} === {str(named).lower()}")


def test_a_series_is_switched_off_in_all_panels_and_on_again(visit):
    key = visit.page.locator("#figure-velocity .keys button", has_text="euclidean")
    wait_until(visit, 3, True)
    key.click()
    assert key.get_attribute("aria-pressed") == "false"
    wait_until(visit, 0, False)
    key.press("Enter")
    wait_until(visit, 3, True)


def test_hovering_says_series_value_and_unit(visit, five_filters):
    chart = visit.page.locator("#figure-time_per_frame .chart")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    said = ""
    for share in (0.6, 0.55, 0.5, 0.45, 0.4, 0.65, 0.7, 0.75, 0.8):
        visit.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + share * box["height"])
        visit.page.wait_for_timeout(80)
        said = visit.value("document.querySelector('.hint:not([hidden])')?.textContent ?? ''")
        if said:
            break
    assert "Time per frame (ms): " in said
    assert any(behaviour.name in said for behaviour in five_filters)
    visit.page.mouse.move(0, 0)
    visit.page.wait_for_function("document.querySelector('.hint').hidden")


def test_colours_follow_the_page_from_light_to_dark(visit):
    colours = """() => [document.body, document.querySelector("#figure-velocity .chart svg path[stroke*=series-2]"),
            document.querySelector("#figure-velocity .stage > svg text")]
        .map(part => getComputedStyle(part)).map(style => [style.backgroundColor, style.stroke, style.fill].join())"""
    light = visit.value(colours)
    visit.page.emulate_media(color_scheme="dark")
    dark = visit.value(colours)
    assert all(a != b for a, b in zip(light, dark, strict=True))
    assert visit.complaints == []


def test_the_wheel_scrolls_the_page_and_with_ctrl_it_zooms(visit):
    domain = "JSON.stringify(document.querySelector('#figure-velocity').view.signal('zoom_0'))"
    turn_the_wheel_on_the_first_panel_until(visit, 60, "scrollY !== window.placed")
    assert visit.value(domain) == "{}"
    visit.page.keyboard.down("Control")
    turn_the_wheel_on_the_first_panel_until(visit, -60, f"{domain} !== '{{}}'")
    visit.page.keyboard.up("Control")


def turn_the_wheel_on_the_first_panel_until(visit, step, condition):
    """Step by step, the pointer put there anew each time: a busy browser loses steps, or scrolls late."""
    from playwright.sync_api import TimeoutError as TooLate

    chart = visit.page.locator("#figure-velocity .chart")
    for _ in range(30):
        visit.value("document.querySelector('#figure-velocity').scrollIntoView({block: 'center', behavior: 'instant'})")
        visit.value("window.placed = scrollY")
        box = chart.bounding_box()
        visit.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
        visit.page.mouse.wheel(0, step)
        try:
            visit.page.wait_for_function(condition, timeout=2000)
        except TooLate:
            continue
        return
    raise AssertionError(f"not so after 30 steps of the wheel: {condition}")


def test_a_phone_does_not_scroll_sideways(visit):
    visit.page.set_viewport_size({"width": 390, "height": 844})
    assert not visit.is_wider_than_the_window()


def test_in_print_the_drawings_take_the_place_of_the_charts(visit):
    visit.page.emulate_media(media="print")
    shown = "document.querySelector('#figure-nees {}').getBoundingClientRect().height > 100"
    assert visit.value(shown.format(".stage > svg"))
    assert not visit.value(shown.format(".chart"))
    visit.page.emulate_media(media="screen")
    printed = visit.page.pdf(format="A4")
    assert printed.startswith(b"%PDF")
    assert len(printed) > 50_000
    assert visit.complaints == []


def test_without_javascript_the_drawings_and_tables_are_there(browser, path, five_filters):
    context = browser.new_context(java_script_enabled=False, color_scheme="dark")
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(path.as_uri())
    assert page.locator("figure svg").first.is_visible()
    assert page.locator("figure svg[role=img][aria-label]").count() == page.locator("figure").count() == 19
    assert page.locator(".answers tbody tr").count() == len(five_filters)
    context.close()
