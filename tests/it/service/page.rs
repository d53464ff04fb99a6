//! The page for people.

use super::*;
use crate::program;

#[tokio::test]
async fn the_page_comes_whole_from_the_server_itself() {
    let bench = Bench::new().await;
    let page = bench.get("/").await;
    assert_eq!((page.status.as_u16(), page.header("content-type")), (200, "text/html; charset=utf-8"));
    assert!(page.header("content-security-policy").starts_with("default-src 'none'; script-src 'self'"));
    let html = String::from_utf8(page.body).unwrap();
    let named = |attribute: &str| {
        let parts: Vec<String> =
            html.split(&format!("{attribute}=\"")).skip(1).map(|rest| rest.split('"').next().unwrap().into()).collect();
        parts
    };
    let files = [named("href"), named("src")].concat();
    assert_eq!(files.len(), 2, "{files:?}");
    let mut script = String::new();
    for file in files {
        let reply = bench.get(&format!("/{file}")).await;
        assert_eq!(reply.status, 200, "{file}");
        assert_eq!(reply.header("x-content-type-options"), "nosniff");
        if file.ends_with(".js") {
            assert_eq!(reply.header("content-type"), "text/javascript; charset=utf-8");
            script = String::from_utf8(reply.body).unwrap();
        }
    }
    assert!(!script.contains("http://") && !script.contains("https://") && !script.contains("innerHTML"));
    // What the script looks for is on the page, and each part of an upload has its field.
    let ids = named("id");
    for id in script.split("$(\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(ids.iter().any(|known| known == id), "{id}");
    }
    // Who cannot see it hears what a bar measures, what a column holds, and of the job's state, not of each second.
    let count = |what: &str| html.matches(what).count();
    assert_eq!((count("<progress"), count("<table"), count("aria-live")), (2, 2, 1));
    assert!(html.split("<progress").skip(1).all(|bar| bar.split('>').next().unwrap().contains("aria-label=")));
    for table in html.split("<table").skip(1).map(|rest| rest.split("</table>").next().unwrap()) {
        assert!(["<caption>", "<thead>", "<th scope=\"col\">"].iter().all(|part| table.contains(part)), "{table}");
    }
    assert!(html.contains("<strong id=\"state\" aria-live=\"polite\"></strong>"));
    let fields = named("name");
    for part in ["video", "masks", "keypoints", "camera", "poses", "preset", "height_m", "seed"] {
        assert!(fields.iter().any(|field| field == part), "{part}");
    }
}

#[test]
fn the_script_shows_what_the_api_says() {
    let tool = program::tool("the_script_shows_what_the_api_says", "page", "page.mjs");
    let Some(mut tool) = tool else { return };
    let verdict = tool.output().unwrap();
    assert!(verdict.status.success(), "{}", String::from_utf8_lossy(&verdict.stderr));
}
