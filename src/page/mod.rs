//! Pages for people in one file each: everything is inside, nothing is fetched, and light and dark follow the reader's
//! setting. A page is a [`Page`] of sections; pictures go in as data ([`picture`]), curves as SVG ([`chart`]).

mod chart;
mod picture;
mod style;

use std::fmt::Write;

pub use chart::{Curve, chart};
pub use picture::{heat_map, inline_jpeg, over, shrunk, strip};

/// A page in the making.
pub struct Page {
    title: String,
    body: String,
}

/// Text for HTML.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            c => out.push(c),
        }
    }
    out
}

impl Page {
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), body: format!("<h1>{}</h1>\n", escape(title)) }
    }

    pub fn heading(&mut self, text: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(text));
    }

    pub fn paragraph(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
    }

    /// What `text` explains to those who ask for it.
    pub fn details(&mut self, summary: &str, html: &str) {
        let _ = writeln!(self.body, "<details><summary>{}</summary>{html}</details>", escape(summary));
    }

    /// Names and values, side by side as far as there is room.
    pub fn figures(&mut self, rows: &[(String, String)]) {
        self.body += "<dl>";
        for (name, value) in rows {
            let _ = write!(self.body, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
        }
        self.body += "</dl>\n";
    }

    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) {
        self.body += &table(head, rows);
    }

    /// A box that catches the eye.
    pub fn note(&mut self, title: &str, text: &str, more: &str) {
        let (title, text, more) = (escape(title), escape(text), escape(more));
        let _ = writeln!(self.body, "<div class=note><b>{title}</b> {text}<small>{more}</small></div>");
    }

    /// A picture with what is to be seen in it. `html` is an `img` or an `svg` of this folder.
    pub fn figure(&mut self, html: &str, caption: &str) {
        self.body += &figure(html, caption);
    }

    /// Figures in columns as wide as the reader has room for.
    pub fn figure_row(&mut self, figures: &[(String, String)]) {
        self.body += "<div class=row>";
        self.body.extend(figures.iter().map(|(html, caption)| figure(html, caption)));
        self.body += "</div>\n";
    }

    pub fn finish(self) -> String {
        let Self { title, body } = self;
        let (title, style) = (escape(&title), style::STYLE);
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <title>{title}</title><style>{style}</style></head>\n<body>\n{body}</body></html>\n"
        )
    }
}

fn figure(html: &str, caption: &str) -> String {
    format!("<figure>{html}<figcaption>{}</figcaption></figure>\n", escape(caption))
}

/// A table; columns of numbers stand to the right.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let number = |text: &str| text.chars().all(|c| "0123456789.−-—∞% ".contains(c));
    let mut html = "<div class=wide><table><thead><tr>".to_owned();
    html.extend(head.iter().map(|name| format!("<th>{}</th>", escape(name))));
    html += "</tr></thead><tbody>";
    for row in rows {
        let cell = |text: &String| {
            let class = if number(text) { " class=n" } else { "" };
            format!("<td{class}>{}</td>", escape(text))
        };
        html += "<tr>";
        html.extend(row.iter().map(cell));
        html += "</tr>";
    }
    html + "</tbody></table></div>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_leave_its_place() {
        let mut page = Page::new("a <b>");
        page.note("x\"", "<script>alert(1)</script>", "& so on");
        page.table(&["<i>"], &[vec!["<u>".to_owned(), "12.5".to_owned()]]);
        page.figures(&[("<s>".to_owned(), "<q>".to_owned())]);
        page.figure("<svg></svg>", "<em>");
        let html = page.finish();
        for tag in ["<b>a", "<script", "<i>", "<u>", "<s>", "<q>", "<em>", "a <b>"] {
            assert!(!html.contains(tag), "{tag} got in: {html}");
        }
        assert!(html.contains("<td class=n>12.5</td>") && html.contains("&amp; so on"));
    }

    #[test]
    fn nothing_is_fetched() {
        let mut page = Page::new("page");
        let picture = image::RgbImage::from_pixel(4, 4, image::Rgb([10, 20, 30]));
        page.figure(&inline_jpeg(&picture, 80, "a picture"), "");
        let html = page.finish();
        for way_out in ["http:", "https:", "src=\"/", "url(", "@import", "<link", "<script"] {
            assert!(!html.contains(way_out), "{way_out}");
        }
        assert!(html.contains("src=\"data:image/jpeg;base64,"));
    }
}
