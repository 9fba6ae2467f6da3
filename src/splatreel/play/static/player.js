var wt=Math.PI,xt=60,Tt=320,Le=12;function Pe(n,e,t){let r=new Map,i=[0,0],s=0,o=0,a={x:0,y:0,time:-1/0},l=h=>{r.set(h.pointerId,{x:h.clientX,y:h.clientY,pan:h.button!==0||h.shiftKey}),n.setPointerCapture(h.pointerId),e.camera&&(e.camera.flick(0,0),e.camera.held=!0),i=[0,0],o=0},c=h=>{let p=r.get(h.pointerId),{camera:f}=e;if(!p||!f)return;let w=h.clientX-p.x,W=h.clientY-p.y;if(o+=Math.hypot(w,W),o!==0){if(r.size===1&&!p.pan){let z=wt/Math.max(Math.min(n.clientWidth,n.clientHeight),1);f.orbit(w*z,W*z);let Ae=Math.max((h.timeStamp-s)/1e3,.004);i=[w*z/Ae,W*z/Ae]}else r.size>1&&f.zoom(Fe(r)/Fe(r,h)),f.pan(w/r.size,W/r.size,f.view(n.clientWidth,n.clientHeight).fx);s=h.timeStamp,[p.x,p.y]=[h.clientX,h.clientY],e.invalidate()}},u=h=>{let p=r.get(h.pointerId);r.delete(h.pointerId),!(!p||r.size>0)&&(e.camera&&(e.camera.held=!1),!p.pan&&h.timeStamp-s<xt&&e.camera?.flick(...i),o<Le&&h.type==="pointerup"&&d(h),e.invalidate())},d=h=>{let p=h.timeStamp-a.time<Tt&&Math.hypot(h.clientX-a.x,h.clientY-a.y)<2*Le;a={x:h.clientX,y:h.clientY,time:p?-1/0:h.timeStamp};let{left:f,top:w}=n.getBoundingClientRect();p&&e.focusAt(h.clientX-f,h.clientY-w)},m=h=>{h.preventDefault();let p=h.deltaMode===WheelEvent.DOM_DELTA_LINE?16:1;e.camera?.zoom(Math.exp(Math.min(Math.max(h.deltaY*p,-200),200)*.0015)),e.invalidate()};n.addEventListener("pointerdown",l,{signal:t}),n.addEventListener("pointermove",c,{signal:t}),n.addEventListener("pointerup",u,{signal:t}),n.addEventListener("pointercancel",u,{signal:t}),n.addEventListener("wheel",m,{passive:!1,signal:t}),n.addEventListener("contextmenu",h=>h.preventDefault(),{signal:t})}function Fe(n,e){let t=[...n].map(([s,o])=>e&&s===e.pointerId?{x:e.clientX,y:e.clientY}:o),r=t.reduce((s,o)=>s+o.x,0)/t.length,i=t.reduce((s,o)=>s+o.y,0)/t.length;return Math.max(t.reduce((s,o)=>s+Math.hypot(o.x-r,o.y-i),0)/t.length,1)}function G([n,e,t]){let r=n[0]+e[1]+t[2],i=r>0?[1+r,e[2]-t[1],t[0]-n[2],n[1]-e[0]]:n[0]>e[1]&&n[0]>t[2]?[e[2]-t[1],1+n[0]-e[1]-t[2],n[1]+e[0],t[0]+n[2]]:e[1]>t[2]?[t[0]-n[2],n[1]+e[0],1-n[0]+e[1]-t[2],e[2]+t[1]]:[n[1]-e[0],t[0]+n[2],e[2]+t[1],1-n[0]-e[1]+t[2]];return B(i)}function De([n,e,t,r]){return[[1-2*(t*t+r*r),2*(e*t+n*r),2*(e*r-n*t)],[2*(e*t-n*r),1-2*(e*e+r*r),2*(t*r+n*e)],[2*(e*r+n*t),2*(t*r-n*e),1-2*(e*e+t*t)]]}function Ue(n,e,t){let r=n.reduce((c,u,d)=>c+u*e[d],0),i=r<0?-1:1,s=Math.acos(Math.min(Math.abs(r),1)),o=Math.sin(s),[a,l]=o>1e-4?[Math.sin((1-t)*s)/o,Math.sin(t*s)/o]:[1-t,t];return B(n.map((c,u)=>a*c+i*l*e[u]))}function B(n){let e=Math.hypot(...n)||1;return n.map(t=>t/e)}function Ce(n,{seconds:e,view:t}){let r=[];return e!==null&&r.push(`t=${_e(e,3)}`),t&&r.push(`view=${[...t.eye,...t.turn,t.distance].map(i=>_e(i,4)).join(",")}`),`${n.split("#")[0]}#${r.join("&")}`}function ge(n){let e=new URLSearchParams(n.split("#")[1]??""),t=Number.parseFloat(e.get("t")??""),r=(e.get("view")??"").split(",").map(Number),i=r.length===8&&r.every(Number.isFinite)&&r[7]>0&&Math.hypot(...r.slice(3,7))>.5,[s,o,a,l,c,u,d,m]=r;return{seconds:Number.isFinite(t)?t:null,view:i?{eye:[s,o,a],turn:B([l,c,u,d]),distance:m}:null}}function _e(n,e){return String(Number(n.toFixed(e)))}var y=(n,e)=>[n[0]+e[0],n[1]+e[1],n[2]+e[2]],x=(n,e)=>[n[0]-e[0],n[1]-e[1],n[2]-e[2]],v=(n,e)=>[n[0]*e,n[1]*e,n[2]*e],R=(n,e)=>n[0]*e[0]+n[1]*e[1]+n[2]*e[2],T=n=>Math.sqrt(R(n,n));function _(n,e){return[n[1]*e[2]-n[2]*e[1],n[2]*e[0]-n[0]*e[2],n[0]*e[1]-n[1]*e[0]]}function L(n){let e=T(n);return e>1e-12?v(n,1/e):[0,0,1]}function H(n,e,t){let r=Math.cos(t),i=Math.sin(t),s=R(e,n)*(1-r);return y(y(v(n,r),v(_(e,n),i)),v(e,s))}function Oe(n,e,t,r){let i=s=>[...s,-R(s,n)];return[...i(e),...i(t),...i(r),0,0,0,1]}function A(n){let e=t=>-(n[t]*n[3]+n[4+t]*n[7]+n[8+t]*n[11]);return[e(0),e(1),e(2)]}function q(n,e,t){return{eye:y(v(n.eye,1-t),v(e.eye,t)),turn:Ue(n.turn,e.turn,t),distance:n.distance*(1-t)+e.distance*t}}var Et=2,X=class{stops;constructor(e,t){let r=[...t];for(this.stops=[e];r.length>0;){let i=this.stops.at(-1).eye,s=r.map(({eye:o})=>T(x(o,i)));this.stops.push(...r.splice(s.indexOf(Math.min(...s)),1))}}at(e,t=!1){let{stops:r}=this,i=r.length-1,s=e/Et%(2*i),o=Math.min(s<i?s:2*i-s,i-1e-6),a=Math.floor(o),l=t?0:o-a,c=[a-1,a,a+1,a+2].map(u=>r[Math.min(Math.max(u,0),i)].eye);return{...q(r[a],r[a+1],l),eye:kt(c,l)}}};function kt([n,e,t,r],i){let s=[-i+2*i*i-i**3,2-5*i*i+3*i**3,i+4*i*i-3*i**3,-i*i+i**3];return[n,e,t,r].reduce((o,a,l)=>y(o,v(a,s[l]/2)),[0,0,0])}var St=6,Mt=5,Ne=.1,Rt=.5,M={yaw:0,pitch:0,right:0,down:0,forward:0,zoom:0},Ie=Object.keys(M),j=class{calm=!1;thrust={...M};held=!1;up;home;extent;near;bounds;center;reach;start;poses;pivot=[0,0,0];eye=[0,0,0];right=[1,0,0];down=[0,1,0];forward=[0,0,1];velocity={...M};glide=null;flight=null;moved=!1;constructor({bounds:e,up:t,camera:r,cameras:i,near:s}){let[o,a]=e;this.bounds=e,this.up=L(t),this.home=r,this.near=.2*s,this.extent=Math.max(T(x(a,o)),1e-6),this.center=v(y(o,a),.5);let l=[r,...i].map(({viewmat:c})=>A(c));this.reach=1.5*Math.max(...[o,a,...l].map(c=>T(x(c,this.center)))),this.start=this.stateOf(r),this.poses=i.map(c=>this.stateOf(c)),this.state=this.start}get viewmat(){return Oe(this.eye,this.right,this.down,this.forward)}set viewmat(e){this.state={eye:A(e),turn:$e(e),distance:this.distance}}get state(){return{eye:this.eye,turn:G([this.right,this.down,this.forward]),distance:this.distance}}set state(e){[this.glide,this.flight,this.moved]=[null,null,!1],this.velocity={...M},this.place(e)}reset(){this.glideTo(this.start)}visit(e){let{poses:t}=this;if(t.length===0)return;let r=this.glide?.to.eye??this.eye,i=t.map(o=>T(x(o.eye,r))),s=i.indexOf(Math.min(...i));this.glideTo(t[(s+e+t.length)%t.length])}get flying(){return this.flight!==null}fly(e){this.glide=null,this.flight=e&&this.poses.length>1?{path:new X(this.state,this.poses),at:0}:null}focus([e,t,r]){let i=y(y(this.eye,v(this.right,e)),y(v(this.down,t),v(this.forward,r))),s=L(x(i,this.eye)),o=_(this.forward,s),a=Math.atan2(T(o),R(this.forward,s)),l=c=>a>1e-6?H(c,L(o),a):c;this.glideTo({eye:this.eye,turn:G([l(this.right),l(this.down),s]),distance:T(x(i,this.eye))})}orbit(e,t){this.touch();let r=Math.acos(Math.min(Math.max(R(this.forward,this.up),-1),1)),i=Math.min(Math.max(-t,Math.min(r-Math.PI+Ne,0)),Math.max(r-Ne,0)),s=a=>H(H(a,this.right,i),this.up,-e),o=s(x(this.eye,this.pivot));[this.right,this.down,this.forward]=[s(this.right),s(this.down),s(this.forward)],this.forward=L(this.forward),this.right=L(_(this.down,this.forward)),this.down=_(this.forward,this.right),this.eye=y(this.pivot,o)}pan(e,t,r){this.walk(-e/r,-t/r,0)}walk(e,t,r){this.touch();let i=v(y(y(v(this.right,e),v(this.down,t)),v(this.forward,r)),this.distance);this.eye=y(this.eye,i),this.pivot=y(this.pivot,i)}zoom(e){this.touch();let t=x(this.eye,this.pivot),r=T(t);this.eye=y(this.pivot,v(t,Math.max(r*e,.01*this.extent)/r))}flick(e,t){this.velocity=this.calm?{...M}:{...M,yaw:e,pitch:t}}step(e){if(this.flight)return this.flight.at+=e,this.place(this.flight.path.at(this.flight.at,this.calm)),!0;if(this.glide)return this.stepGlide(e);let{velocity:t,thrust:r}=this,i=this.calm?1:1-Math.exp(-St*e);for(let o of Ie)t[o]+=(r[o]-t[o])*i;let s=Ie.some(o=>Math.abs(t[o])>.02||r[o]!==0);if(!s)this.velocity={...M};else{let o=a=>t[a]*e;(o("yaw")||o("pitch"))&&this.orbit(o("yaw"),o("pitch")),(o("right")||o("down")||o("forward"))&&this.walk(o("right"),o("down"),o("forward")),o("zoom")&&this.zoom(Math.exp(o("zoom")))}return this.stepBack(e)||s}view(e,t){let{K:r,width:i,height:s}=this.home,o=Math.min(e/i,t/s),a=Math.max(e/i,t/s),l=Math.min(a,1.4*o);return{viewmat:this.viewmat,fx:r[0]*l,fy:r[4]*l,cx:e/2+(r[2]-i/2)*l,cy:t/2+(r[5]-s/2)*l,width:e,height:t,near:this.near}}get distance(){return T(x(this.pivot,this.eye))}touch(){[this.glide,this.flight,this.moved]=[null,null,!0]}place({eye:e,turn:t,distance:r}){this.eye=e,[this.right,this.down,this.forward]=De(t),this.pivot=y(e,v(this.forward,r))}stateOf({viewmat:e}){let t=R(x(this.center,A(e)),[e[8],e[9],e[10]]);return{eye:A(e),turn:$e(e),distance:t>.05*this.extent?t:.5*this.extent}}glideTo(e){this.velocity={...M},this.flight=null,this.moved=!1,this.glide={from:this.state,to:e,at:this.calm?1:0}}stepGlide(e){let t=this.glide;t.at=Math.min(t.at+e/Rt,1);let r=t.at*t.at*(3-2*t.at);return this.place(r<1?q(t.from,t.to,r):t.to),r===1&&(this.glide=null),!0}stepBack(e){if(!this.moved||this.held)return!1;let t=this.calm?1:1-Math.exp(-Mt*e),r=.25*this.extent,[i,s]=this.bounds,o=this.pivot.map((d,m)=>Math.min(Math.max(d,i[m]-r),s[m]+r)),a=v(x(o,this.pivot),t);this.pivot=y(this.pivot,a),this.eye=y(this.eye,a);let l=x(this.eye,this.center),c=Math.max(1-this.reach/Math.max(T(l),1e-9),0),u=v(x(this.pivot,this.eye),c*t);return this.eye=y(this.eye,u),T(a)+T(u)>1e-4*this.extent}};function $e(n){return G([[n[0],n[1],n[2]],[n[4],n[5],n[6]],[n[8],n[9],n[10]]])}function be(n,e){let t=0,r=n.length-1;for(;t<r;){let i=t+r+1>>1;n[i].firstFrame<=e?t=i:r=i-1}return t}function Ve(n,e,t,r){let i=r*t;return ve(n,e,i,be(n,i))}function ve(n,e,t,r){let i=t-n[r].firstFrame,s=e>0?Math.min(Math.max(i/e,0),1):1,o=s<1&&r>0;return{current:{group:r,frame:K(n[r],t)},previous:o?{group:r-1,frame:K(n[r-1],t)}:null,weight:o?s:1}}function K(n,e){return Math.min(Math.max(e-n.firstFrame,0),Math.max(n.frames-1,0))}var At=1,Lt=2;function We(n,e,t){let r=new Uint8Array(n);for(let s=0;s<Math.min(n,e.length);s++)r[s]=e[s]*At;let i=t??e;for(let s=0;s<Math.min(n,i.length);s++)r[s]|=i[s]*Lt;return r}function ze(n){return[0,n,1-n,1]}var Y=class{manifest=null;seconds=0;playing=!1;loop=!1;speed=1;get duration(){return this.manifest?this.manifest.frames/this.manifest.fps:0}get live(){return this.manifest?.live===!0}get edge(){let{manifest:e}=this;return e?e.groups.at(-1).firstFrame/e.fps:0}get ended(){return this.duration>0&&!this.live&&this.seconds>=this.duration}get rate(){return this.speed}set rate(e){this.speed=Math.min(Math.max(e,0),16)}get frame(){let{fps:e,frames:t}=this.manifest;return Math.min(this.seconds*e,Math.max(t-1,0))}get moment(){let{groups:e,overlap:t,fps:r}=this.manifest;return Ve(e,t,r,this.frame/r)}seek(e){this.seconds=Math.min(Math.max(e,0),this.duration)}framesOn(e){let{fps:t,frames:r}=this.manifest;return Math.min(Math.max(Math.round(this.frame)+e,0),r-1)/t}advance(e){let{duration:t,live:r,loop:i}=this;return r&&!i&&this.seconds>=t?!1:(this.seconds+=e*this.speed,this.seconds>=t&&(i?this.seconds=r?this.edge:this.seconds%t:this.seconds=t),!0)}};var b=class extends Error{name="ReelError"};function O(n){return n instanceof Error?n.message:String(n)}var C=class extends Error{name="DeviceLostError";constructor(){super("The graphics device was lost. The player goes on when it is back.")}};var Q=[300,1e3,2e3,4e3,6e3];var F=class extends Error{constructor(t,r=Q.length,i=0){super(t);this.tries=r;this.status=i}tries;status},Ge=2;function Be(n,e,t){return Ft(n,e,t,async()=>(await Pt(n,{cache:"no-cache",signal:t},Ge)).text().catch(i=>Promise.reject(new F(O(i),Ge))))}async function Ft(n,e,t,r){for(let i=0;;)try{return await r(i>0)}catch(s){if(t.aborted||!(s instanceof F))throw s;let o=navigator.onLine===!1;if(!o&&i>=s.tries)throw new b(`${n} cannot be downloaded: ${s.message}.`);e.trouble(o?"Offline. Waiting for the network.":`Trying again: ${s.message}.`),await Ut(Q[i]*(1+Math.random()/2),t),(!o||i<Q.length-1)&&i++}}async function Pt(n,e,t=Q.length){let r;try{r=await fetch(n,e)}catch(s){throw await Dt(n)?new b(`${n} is there, but its host does not let pages of ${location.origin} read it. It must send the header Access-Control-Allow-Origin.`):new F(`${O(s)}. Check the address and the network`,t)}if(r.ok)return r;let i=`it answered ${r.status} ${r.statusText}`.trim();throw r.status>=500||[408,416,425,429].includes(r.status)?new F(i,t,r.status):new b(`${n} cannot be downloaded: ${i}.`)}function Dt(n){return new URL(n,location.href).origin===location.origin?Promise.resolve(!1):fetch(n,{mode:"no-cors"}).then(()=>!0,()=>!1)}function Ut(n,e){return new Promise((t,r)=>{let i=()=>{clearTimeout(s),removeEventListener("online",i),e.removeEventListener("abort",i),e.aborted?r(e.reason):t()},s=setTimeout(i,n);addEventListener("online",i),e.addEventListener("abort",i)})}async function Z(n,e,t){let r=await Be(n,e,t),i;try{i=JSON.parse(r)}catch{throw new b(`${n} is not a reel's manifest: it is not JSON.`)}return _t(i,new URL(n,location.href).href)}function _t(n,e){let t=D(n,"the manifest");if(t.format!=="splatreel")throw new b(`${e} is not a reel: its format is ${JSON.stringify(t.format)}.`);if(t.version!==1)throw new b(`${e} is a reel of version ${JSON.stringify(t.version)}; this player knows version 1.`);let r=P(t.bounds,"bounds").map(a=>J(a,3,"bounds"));if(r.length!==2)throw new b(`${e}: bounds needs two corners.`);let i=Ot(t.renditions),s=P(t.groups,"groups").map((a,l)=>Nt(a,l,i)),o=t.live===!0;if(s.length===0&&!o)throw new b(`${e} holds no group yet.`);return{url:e,live:o,fps:N(t.fps,"fps"),frames:s.length>0?N(t.frames,"frames"):0,overlap:k(t.overlap,"overlap"),shDegree:k(t.sh_degree,"sh_degree"),near:t.near===void 0?.01:N(t.near,"near"),bounds:r,up:J(t.up,3,"up"),camera:He(t.camera),cameras:P(t.cameras??[],"cameras").map(He),layers:P(t.layers,"layers").map((a,l)=>ye(a,l)),groups:s,renditions:i.map(a=>({name:a,bytes:s.reduce((l,c)=>l+Ct(c,a).bytes,0)}))}}function Ct(n,e){return n.renditions.get(e)??n}function Ot(n){let e=P(n??[],"renditions").map(r=>D(r,"a rendition").name),t=e.filter(r=>typeof r=="string"&&/^[a-z0-9][a-z0-9_-]{0,31}$/.test(r));if(new Set(t).size<e.length||e.length>16)throw new b("The manifest is damaged: its renditions have no names of their own.");return t.length>1?t:[]}function Nt(n,e,t){let r=ye(n,e),i=D(n.renditions??{},"a group's renditions");for(let s of t.slice(1)){let{firstFrame:o,frames:a}=r,l=ye(D(i[s],`rendition ${s} of group ${e}`),e);r.renditions.set(s,{...l,firstFrame:o,frames:a,group:r.group})}return r}var It=/^[A-Za-z0-9_][A-Za-z0-9_.-]*(\/[A-Za-z0-9_][A-Za-z0-9_.-]*)*$/;function ye(n,e){let t=D(n,"a file");if(typeof t.uri!="string"||t.uri.length>500||!It.test(t.uri))throw new b(`The manifest is damaged: it names the file ${JSON.stringify(t.uri)?.slice(0,100)}; only plain relative paths are read.`);return{uri:t.uri,bytes:k(t.bytes,"bytes"),sha256:typeof t.sha256=="string"?t.sha256:null,firstFrame:k(t.first_frame??0,"first_frame"),frames:k(t.frames??0,"frames"),points:k(t.points,"points"),group:k(t.group??e,"group"),renditions:new Map}}function He(n){let e=D(n,"a camera");return{name:String(e.name??""),width:N(e.width,"camera width"),height:N(e.height,"camera height"),K:J(e.K,9,"camera K"),viewmat:J(e.viewmat,16,"camera viewmat")}}function D(n,e){if(typeof n!="object"||n===null||Array.isArray(n))throw new b(`The manifest is damaged: ${e} is not an object.`);return n}function P(n,e){if(!Array.isArray(n))throw new b(`The manifest is damaged: ${e} is not a list.`);return n}function k(n,e){if(typeof n!="number"||!Number.isFinite(n))throw new b(`The manifest is damaged: ${e} is ${JSON.stringify(n)}, not a number.`);return n}function N(n,e){let t=k(n,e);if(t<=0)throw new b(`The manifest is damaged: ${e} is ${t}.`);return t}function J(n,e,t){let r=P(n,t).flat();if(r.length!==e)throw new b(`The manifest is damaged: ${t} has ${r.length} numbers, not ${e}.`);return r.map(i=>k(i,t))}var $t=3e3;async function we(n,e){let t={received:()=>{},trouble:()=>{}};for(;;){await new Promise(i=>setTimeout(i,$t));let r=await Z(n.url,t,e).catch(()=>null);if(e.throwIfAborted(),r&&(r.groups.length>n.groups.length||!r.live))return r}}async function qe(n,e,t){for(;n.live;){let r=await we(n,t).catch(()=>null);if(r===null)return;Object.assign(n,r),e()}}var ee=class{quality="auto";interval=1e3/60;scale=1;last=0;count=0;patience=2;waited=0;get ratio(){return Math.min(globalThis.devicePixelRatio||1,2)*{auto:this.scale,full:1,half:.5}[this.quality]}drawn(e,t){let r=t-this.last;this.last=e?t:0,!(!e||r>2e3)&&(this.interval+=(r-this.interval)*.1,++this.count%12===0&&this.judge())}judge(){this.interval>27&&this.scale>.5?(this.waited===0&&(this.patience*=2),this.scale=Math.max(.8*this.scale,.5),this.waited=0):this.interval<17.5&&this.scale<1&&++this.waited>this.patience&&(this.scale=Math.min(1.25*this.scale,1),this.waited=0)}};function je(n,e,t,r){let i=new Float32Array(n.buffer),s=new Float32Array(e.buffer),o=[];for(let a=0;a<n.length;a+=4){let l=s[a+2];if(!(l>0))continue;let c=t-i[a],u=r-i[a+1],d=Xe(n[a+2],c,u),m=Xe(n[a+3],c,u),h=(d*d+m*m)*l*l;h<l*l&&o.push({depth:s[a+3],alpha:xe(e[a+1]>>>16)*Math.exp(-.5*h)})}return o}function Ke(n){let e=1;for(let{depth:t,alpha:r}of n.sort((i,s)=>i.depth-s.depth))if(e*=1-r,e<.5)return t;return null}function Xe(n,e,t){let[r,i]=[xe(n&65535),xe(n>>>16)];return(r*e+i*t)/Math.max(r*r+i*i,1e-12)}function xe(n){let e=n>>10&31,t=n&1023,r=e===0?t*2**-24:(1024+t)*2**(e-25);return n&32768?-r:r}var te=class{taken=[];take(e){let t=0,r=0;for(;r<this.taken.length&&this.taken[r].first-t<e;r++)t=this.taken[r].first+this.taken[r].count;return this.taken.splice(r,0,{first:t,count:e}),t}give(e,t){this.taken.splice(this.taken.findIndex(r=>r.first===e&&r.count===t),1)}get end(){let e=this.taken.at(-1);return e?e.first+e.count:0}};var re=3,ie=15,U=128,Ye=`#version 300 es
void main() {
  // One triangle that covers the viewport.
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`,Qe=`#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2DArray uPoints;
uniform highp sampler2D uCodebook;
uniform highp usampler2D uFlags;
uniform highp usampler2DArray uDx;
uniform highp usampler2DArray uDq;
uniform highp usampler2DArray uShade;
uniform int uFirstRow;
uniform int uCount;
uniform int uShDegree;
uniform bool uMoving, uShaded;
uniform ivec2 uFrames;
uniform float uBetween;
uniform vec3 uDxMin, uDxStep;
uniform vec4 uDqMin, uDqStep;
uniform vec4 uShadeMin, uShadeStep;
uniform vec4 uWeights;
uniform mat4 uView;
uniform vec3 uEye;
uniform vec4 uLens;
uniform vec4 uRange;
uniform vec2 uSize;
uniform float uNear;
layout(location = 0) out uvec4 outShape;
layout(location = 1) out uvec4 outColor;

const float BLUR = 0.3;
/** Splats end where their alpha is less than this. Training draws to 1/255: a quarter more pixels for two decibels above 48. */
const float LEAST_ALPHA = 0.01;

mat3 rotationOf(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec4 multiply(vec4 a, vec4 b) {
  return vec4(a.x * b.x - dot(a.yzw, b.yzw), a.x * b.yzw + b.x * a.yzw + cross(a.yzw, b.yzw));
}

vec3 movedBy(ivec2 at) {
  vec3 low = vec3(texelFetch(uDx, ivec3(at, uFrames.x), 0).xyz);
  vec3 high = vec3(texelFetch(uDx, ivec3(at, uFrames.y), 0).xyz);
  return uDxMin + uDxStep * mix(low, high, uBetween);
}

vec4 turnedBy(ivec2 at) {
  vec4 low = normalize(uDqMin + uDqStep * vec4(texelFetch(uDq, ivec3(at, uFrames.x), 0)));
  vec4 high = normalize(uDqMin + uDqStep * vec4(texelFetch(uDq, ivec3(at, uFrames.y), 0)));
  return normalize(mix(low, dot(low, high) < 0.0 ? -high : high, uBetween));
}

/** What the DC term and the opacity gain. */
vec4 shadedBy(ivec2 at) {
  vec4 low = vec4(texelFetch(uShade, ivec3(at, uFrames.x), 0));
  vec4 high = vec4(texelFetch(uShade, ivec3(at, uFrames.y), 0));
  return uShadeMin + uShadeStep * mix(low, high, uBetween);
}

/** The view-dependent part of a colour: coefficients 1..15 in the 3DGS order, one texel each. */
vec3 viewDependent(int index, vec3 d) {
  ivec2 at = ivec2((index % ${U}) * ${ie}, index / ${U});
  #define REST(i) texelFetch(uCodebook, at + ivec2(i, 0), 0).rgb
  float x = d.x, y = d.y, z = d.z;
  vec3 color = 0.4886025119029199 * (z * REST(1) - y * REST(0) - x * REST(2));
  if (uShDegree < 2) return color;
  float xx = x * x, yy = y * y, zz = z * z;
  color += 1.0925484305920792 * (x * y * REST(3) - y * z * REST(4) - x * z * REST(6))
    + 0.31539156525252005 * (2.0 * zz - xx - yy) * REST(5)
    + 0.5462742152960396 * (xx - yy) * REST(7);
  if (uShDegree < 3) return color;
  return color - 0.5900435899266435 * y * (3.0 * xx - yy) * REST(8)
    + 2.890611442640554 * x * y * z * REST(9)
    - 0.4570457994644658 * y * (4.0 * zz - xx - yy) * REST(10)
    + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * REST(11)
    - 0.4570457994644658 * x * (4.0 * zz - xx - yy) * REST(12)
    + 1.445305721320277 * z * (xx - yy) * REST(13)
    - 0.5900435899266435 * x * (xx - 3.0 * yy) * REST(14);
}

void main() {
  outShape = uvec4(0u);
  outColor = uvec4(0u);
  ivec2 at = ivec2(gl_FragCoord.xy) - ivec2(0, uFirstRow);
  if (at.y * ${1024} + at.x >= uCount) return;
  float weight = uMoving ? uWeights.x : uWeights[texelFetch(uFlags, at, 0).x];
  if (weight <= 0.0) return;

  uvec4 p0 = texelFetch(uPoints, ivec3(at, 0), 0);
  uvec4 p1 = texelFetch(uPoints, ivec3(at, 1), 0);
  uvec4 p2 = texelFetch(uPoints, ivec3(at, 2), 0);
  vec3 mean = uintBitsToFloat(p0.xyz);
  vec3 scale = uintBitsToFloat(p1.xyz);
  vec2 opacityAndRed = unpackHalf2x16(p1.w);
  vec4 quat = vec4(unpackHalf2x16(p2.x), unpackHalf2x16(p2.y));
  vec3 color = vec3(opacityAndRed.y, unpackHalf2x16(p2.z));
  if (uMoving) {
    mean += movedBy(at);
    quat = multiply(quat, turnedBy(at));
  }
  if (uShaded) {
    vec4 gain = shadedBy(at);
    color += gain.rgb;
    opacityAndRed.x = clamp(opacityAndRed.x + gain.a, 0.0, 1.0);
  }
  // Faded in optical depth: two coinciding points of weights w and 1 - w absorb what one does.
  float opacity = 1.0 - pow(1.0 - min(opacityAndRed.x, 0.9999), weight);
  if (opacity <= LEAST_ALPHA) return;

  vec3 camera = (uView * vec4(mean, 1.0)).xyz;
  if (camera.z < uNear) return;
  vec2 slope = clamp(camera.xy / camera.z, uRange.xz, uRange.yw);
  vec2 focal = uLens.xy / camera.z;
  // Rows of the projection's Jacobian times the world-to-camera rotation, then times rotation and scales.
  mat3 view = transpose(mat3(uView));
  mat3 turn = rotationOf(normalize(quat));
  vec3 a = (focal.x * (view[0] - slope.x * view[2])) * turn * scale;
  vec3 b = (focal.y * (view[1] - slope.y * view[2])) * turn * scale;
  float xx = dot(a, a) + BLUR;
  float yy = dot(b, b) + BLUR;
  float xy = dot(a, b);

  // Axes of the ellipse where alpha falls to the least.
  float middle = 0.5 * (xx + yy);
  float spread = length(vec2(0.5 * (xx - yy), xy));
  float major = middle + spread;
  float minor = max(middle - spread, 0.0);
  vec2 direction = abs(xy) < 1e-6 * major ? (xx >= yy ? vec2(1, 0) : vec2(0, 1)) : normalize(vec2(xy, major - xx));
  float extent = sqrt(2.0 * log(opacity / LEAST_ALPHA));
  vec2 axis = direction * sqrt(major) * extent;
  vec2 other = vec2(-direction.y, direction.x) * sqrt(minor) * extent;

  vec2 center = focal * camera.xy + uLens.zw;
  vec2 reach = abs(axis) + abs(other);
  if (any(lessThan(center + reach, vec2(0.0))) || any(greaterThan(center - reach, uSize))) return;
  color *= 0.28209479177387814;
  if (uShDegree > 0) color += viewDependent(int(p0.w), normalize(mean - uEye));
  color = max(color + 0.5, 0.0);
  outShape = uvec4(floatBitsToUint(center), packHalf2x16(axis), packHalf2x16(other));
  outColor = uvec4(packHalf2x16(color.rg), packHalf2x16(vec2(color.b, opacity)), floatBitsToUint(extent), floatBitsToUint(camera.z));
}`,Je=`#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D uShape;
uniform highp usampler2D uColor;
uniform highp usampler2D uOrder;
uniform vec2 uSize;
out vec2 vAt;
flat out vec4 vColor;
flat out float vFall;
void main() {
  gl_Position = vec4(2.0, 2.0, 0.0, 1.0); // outside: nothing is drawn
  uint point = texelFetch(uOrder, ivec2(gl_VertexID >> 2, gl_InstanceID), 0).x;
  if (point == ${4294967295}u) return;
  ivec2 at = ivec2(point % ${1024}u, point / ${1024}u);
  uvec4 color = texelFetch(uColor, at, 0);
  float extent = uintBitsToFloat(color.z);
  if (extent <= 0.0) return;
  uvec4 shape = texelFetch(uShape, at, 0);
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  vec2 pixel = uintBitsToFloat(shape.xy) + corner.x * unpackHalf2x16(shape.z) + corner.y * unpackHalf2x16(shape.w);
  gl_Position = vec4(pixel / uSize * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
  vAt = corner;
  vColor = vec4(unpackHalf2x16(color.x), unpackHalf2x16(color.y));
  // exp(-r^2 / 2) at r standard deviations, as a power of two of the place in the quad.
  vFall = -0.7213475204444817 * extent * extent;
}`,Ze=`#version 300 es
precision highp float;
in vec2 vAt;
flat in vec4 vColor;
flat in float vFall;
out vec4 outColor;
void main() {
  float square = dot(vAt, vAt);
  if (square > 1.0) discard;
  float alpha = min(0.999, vColor.a * exp2(vFall * square));
  outColor = vec4(vColor.rgb * alpha, alpha);
}`;function E(n){return Math.ceil(n/1024)}var se=class{constructor(e,t,r,i){this.gl=e;this.firstRow=t;this.count=r.count,this.shDegree=r.shDegree,r.count!==0&&(this.points=this.uploadPoints(r),r.shDegree>0&&(this.codebook=this.uploadCodebook(r.codebook,3*((r.shDegree+1)**2-1))),i&&(this.range=i,this.dx=this.uploadFrames(i.dx,i.frames,e.RGBA16UI,e.UNSIGNED_SHORT),this.dq=this.uploadFrames(i.dq,i.frames,e.RGBA8UI,e.UNSIGNED_BYTE),i.shade&&(this.shade=this.uploadFrames(i.shade.data,i.frames,e.RGBA8UI,e.UNSIGNED_BYTE))))}gl;firstRow;count;shDegree;points=null;codebook=null;range=null;flags=null;dx=null;dq=null;shade=null;setFlags(e){if(this.count===0)return;let{gl:t}=this,r=E(this.count),i=new Uint8Array(r*1024);i.set(e),this.flags===null&&(this.flags=this.create(t.TEXTURE_2D),t.texStorage2D(t.TEXTURE_2D,1,t.R8UI,1024,r)),t.bindTexture(t.TEXTURE_2D,this.flags),t.pixelStorei(t.UNPACK_ALIGNMENT,1),t.texSubImage2D(t.TEXTURE_2D,0,0,0,1024,r,t.RED_INTEGER,t.UNSIGNED_BYTE,i)}delete(){for(let e of[this.points,this.codebook,this.flags,this.dx,this.dq,this.shade])this.gl.deleteTexture(e)}uploadPoints(e){let{gl:t}=this,r=E(e.count),i=r*1024*4,s=new Uint32Array(re*i),o=new Float32Array(s.buffer),{means:a,quats:l,scales:c,opacities:u,shBase:d,shRest:m}=e;for(let p=0;p<e.count;p++){let f=4*p;for(let w=0;w<3;w++)o[f+w]=a[3*p+w];s[f+3]=m[p],f+=i;for(let w=0;w<3;w++)o[f+w]=c[3*p+w];s[f+3]=ne(u[p],d[3*p]),f+=i,s[f]=ne(l[4*p],l[4*p+1]),s[f+1]=ne(l[4*p+2],l[4*p+3]),s[f+2]=ne(d[3*p+1],d[3*p+2])}let h=this.create(t.TEXTURE_2D_ARRAY);return t.texStorage3D(t.TEXTURE_2D_ARRAY,1,t.RGBA32UI,1024,r,re),t.texSubImage3D(t.TEXTURE_2D_ARRAY,0,0,0,0,1024,r,re,t.RGBA_INTEGER,t.UNSIGNED_INT,s),h}uploadCodebook(e,t){let{gl:r}=this,i=e.length/t,s=Math.ceil(i/U),o=r.getParameter(r.MAX_TEXTURE_SIZE);if(s>o)throw new b(`A file of the reel has more view-dependent colours than this device holds (${i} of ${o*U}).`);let a=U*ie,l=new Float32Array(s*a*4);for(let u=0;u<i;u++)for(let d=0;d<t;d++)l[4*(u*ie+Math.floor(d/3))+d%3]=e[u*t+d];let c=this.create(r.TEXTURE_2D);return r.texStorage2D(r.TEXTURE_2D,1,r.RGBA16F,a,s),r.texSubImage2D(r.TEXTURE_2D,0,0,0,a,s,r.RGBA,r.FLOAT,l),c}uploadFrames(e,t,r,i){let{gl:s,count:o}=this,a=this.create(s.TEXTURE_2D_ARRAY);s.texStorage3D(s.TEXTURE_2D_ARRAY,1,r,1024,E(o),t),s.pixelStorei(s.UNPACK_ALIGNMENT,1);let l=Math.floor(o/1024),c=o-l*1024,u=(d,m,h,p)=>{let f=4*(d*o+m*1024),w=e.subarray(f,f+4*h*p);s.texSubImage3D(s.TEXTURE_2D_ARRAY,0,0,m,d,h,p,1,s.RGBA_INTEGER,i,w)};for(let d=0;d<t;d++)l>0&&u(d,0,1024,l),c>0&&u(d,l,c,1);return a}create(e){let{gl:t}=this,r=t.createTexture();t.bindTexture(e,r);for(let i of[t.TEXTURE_MIN_FILTER,t.TEXTURE_MAG_FILTER])t.texParameteri(e,i,t.NEAREST);for(let i of[t.TEXTURE_WRAP_S,t.TEXTURE_WRAP_T])t.texParameteri(e,i,t.CLAMP_TO_EDGE);return r}},tt=new Float32Array(1),Wt=new Uint32Array(tt.buffer);function et(n){tt[0]=n;let e=Wt[0],t=e>>>16&32768,r=e&2147483647;return r>=1199570944?t|31743:r<947912704?t|Math.round(Math.abs(n)*2**24):Math.min((t|r-939524096+4096>>>13)&65535,t|31743)}function ne(n,e){return(et(n)|et(e)<<16)>>>0}var oe=class{constructor(e){this.canvas=e;let t=e.getContext("webgl2",{alpha:!1,antialias:!1,depth:!1,powerPreference:"high-performance"});if(!t)throw new b("This browser or device offers no WebGL 2, which the player draws with.");this.gl=t,this.project=new ae(t,Ye,Qe),this.splat=new ae(t,Je,Ze),this.target=t.createFramebuffer(),this.empty=t.createVertexArray(),this.quads=t.createVertexArray(),this.corners=t.createBuffer(),t.bindVertexArray(this.quads),t.bindBuffer(t.ELEMENT_ARRAY_BUFFER,this.corners),t.bufferData(t.ELEMENT_ARRAY_BUFFER,Gt(),t.STATIC_DRAW),t.bindVertexArray(null)}canvas;gl;project;splat;target;shape=null;color=null;quads;empty;corners;order=null;orderRows=0;rows=new te;capacity=0;layers=[];groups=new Map;flagsKey="";drawn=0;get lost(){return this.gl.isContextLost()}addLayer(e,t){let r=this.upload(t);return this.layers[e]=r,this.flagsKey="",r.firstRow*1024}addGroup(e,t){let r=this.upload(t);return this.groups.set(e,{textures:r,alive:t.alive}),r.firstRow*1024}dropGroup(e){let t=this.groups.get(e)?.textures;t&&(this.groups.delete(e),this.rows.give(t.firstRow,E(t.count)),t.delete())}holds(e){return[e.current,e.previous].every(t=>t===null||this.groups.has(t.group))}setOrder(e,t){let{gl:r}=this,i=E(t);i>this.orderRows&&(r.deleteTexture(this.order),this.orderRows=Math.max(i,Math.ceil(1.25*this.orderRows)),this.order=this.integerTexture(r.R32UI,this.orderRows)),r.bindTexture(r.TEXTURE_2D,this.order),r.texSubImage2D(r.TEXTURE_2D,0,0,0,1024,i,r.RED_INTEGER,r.UNSIGNED_INT,e),this.drawn=t}draw(e,t,r){let{gl:i,canvas:s}=this;(s.width!==r.width||s.height!==r.height)&&([s.width,s.height]=[r.width,r.height]),this.updateFlags(e),this.projectPoints(e,t,r),i.bindFramebuffer(i.FRAMEBUFFER,null),i.viewport(0,0,r.width,r.height),i.clearColor(0,0,0,1),i.clear(i.COLOR_BUFFER_BIT),this.splat.use(),this.splat.texture("uShape",0,i.TEXTURE_2D,this.shape),this.splat.texture("uColor",1,i.TEXTURE_2D,this.color),this.splat.texture("uOrder",2,i.TEXTURE_2D,this.order),i.uniform2f(this.splat.at("uSize"),r.width,r.height),i.bindVertexArray(this.quads),i.enable(i.BLEND),i.blendFunc(i.ONE,i.ONE_MINUS_SRC_ALPHA),i.drawElementsInstanced(i.TRIANGLES,6*1024,i.UNSIGNED_SHORT,0,E(this.drawn)),i.disable(i.BLEND)}readPixels(){let{gl:e,canvas:t}=this,{width:r,height:i}=t,s=new Uint8Array(4*r*i);e.readPixels(0,0,r,i,e.RGBA,e.UNSIGNED_BYTE,s);let o=new Uint8Array(s.length);for(let a=0;a<i;a++)o.set(s.subarray(4*r*a,4*r*(a+1)),4*r*(i-1-a));return o}depthAt({layers:e,current:t,previous:r},i,s){let{gl:o}=this,a=[t,r].map(c=>c&&this.groups.get(c.group)?.textures),l=[];o.bindFramebuffer(o.FRAMEBUFFER,this.target);for(let c of[...this.layers.slice(0,e),...a]){if(!c||c.count===0)continue;let[u,d]=[o.COLOR_ATTACHMENT0,o.COLOR_ATTACHMENT1].map(m=>{let h=new Uint32Array(4*E(c.count)*1024);return o.readBuffer(m),o.readPixels(0,c.firstRow,1024,E(c.count),o.RGBA_INTEGER,o.UNSIGNED_INT,h),h});for(let m of je(u,d,i,s))l.push(m)}return Ke(l)}destroy(){let{gl:e}=this;for(let t of[...this.layers,...[...this.groups.values()].map(r=>r.textures)])t?.delete();for(let t of[this.shape,this.color,this.order])e.deleteTexture(t);for(let t of[this.quads,this.empty])e.deleteVertexArray(t);e.deleteFramebuffer(this.target),e.deleteBuffer(this.corners),this.project.delete(),this.splat.delete()}upload(e){let t=this.rows.take(E(e.points.count));return this.rows.end>this.capacity&&this.grow(),new se(this.gl,t,e.points,e.offsets)}grow(){let{gl:e}=this,t=e.getParameter(e.MAX_TEXTURE_SIZE),{end:r}=this.rows;if(r>t)throw new b(`The reel has more points than this device draws (${r*1024} of ${t*1024}).`);this.capacity=Math.min(Math.max(r,Math.ceil(1.5*this.capacity)),t);for(let i of[this.shape,this.color])e.deleteTexture(i);this.shape=this.integerTexture(e.RGBA32UI,this.capacity),this.color=this.integerTexture(e.RGBA32UI,this.capacity),e.bindFramebuffer(e.FRAMEBUFFER,this.target),e.framebufferTexture2D(e.FRAMEBUFFER,e.COLOR_ATTACHMENT0,e.TEXTURE_2D,this.shape,0),e.framebufferTexture2D(e.FRAMEBUFFER,e.COLOR_ATTACHMENT1,e.TEXTURE_2D,this.color,0),e.drawBuffers([e.COLOR_ATTACHMENT0,e.COLOR_ATTACHMENT1])}updateFlags(e){let t=`${e.layers} ${e.current?.group} ${e.previous?.group}`;if(t===this.flagsKey)return;this.flagsKey=t;let r=this.layers.slice(0,e.layers),i=r.reduce((l,c)=>l+c.count,0),s=e.current?this.groups.get(e.current.group).alive:new Uint8Array(i).fill(1),o=We(i,s,e.previous?this.groups.get(e.previous.group).alive:null),a=0;for(let l of r)l.setFlags(o.subarray(a,a+l.count)),a+=l.count}projectPoints(e,t,r){let{gl:i,project:s}=this;i.bindFramebuffer(i.FRAMEBUFFER,this.target),i.bindVertexArray(this.empty),s.use(),zt(i,s,r),i.uniform1i(s.at("uMoving"),0),i.uniform4fv(s.at("uWeights"),ze(t));for(let o of this.layers.slice(0,e.layers))this.projectFile(o);i.uniform1i(s.at("uMoving"),1),this.projectGroup(e.current,t),this.projectGroup(e.previous,1-t)}projectGroup(e,t){let r=e&&this.groups.get(e.group).textures;if(!e||!r||!r.range)return;let{gl:i,project:s}=this,{frames:o,dxMin:a,dxStep:l,dqMin:c,dqStep:u,shade:d}=r.range,m=Math.min(Math.floor(e.frame),o-1);i.uniform2i(s.at("uFrames"),m,Math.min(m+1,o-1)),i.uniform1f(s.at("uBetween"),e.frame-m),i.uniform3fv(s.at("uDxMin"),a),i.uniform3fv(s.at("uDxStep"),l),i.uniform4fv(s.at("uDqMin"),c),i.uniform4fv(s.at("uDqStep"),u),i.uniform4fv(s.at("uShadeMin"),d?.min??[0,0,0,0]),i.uniform4fv(s.at("uShadeStep"),d?.step??[0,0,0,0]),i.uniform4f(s.at("uWeights"),t,0,0,0),this.projectFile(r)}projectFile(e){if(e.count===0)return;let{gl:t,project:r}=this;r.texture("uPoints",0,t.TEXTURE_2D_ARRAY,e.points),r.texture("uCodebook",1,t.TEXTURE_2D,e.codebook),r.texture("uFlags",2,t.TEXTURE_2D,e.flags),r.texture("uDx",3,t.TEXTURE_2D_ARRAY,e.dx),r.texture("uDq",4,t.TEXTURE_2D_ARRAY,e.dq),r.texture("uShade",5,t.TEXTURE_2D_ARRAY,e.shade),t.uniform1i(r.at("uShaded"),e.shade?1:0),t.uniform1i(r.at("uFirstRow"),e.firstRow),t.uniform1i(r.at("uCount"),e.count),t.uniform1i(r.at("uShDegree"),e.shDegree),t.viewport(0,e.firstRow,1024,E(e.count)),t.drawArrays(t.TRIANGLES,0,3)}integerTexture(e,t){let{gl:r}=this,i=r.createTexture();return r.bindTexture(r.TEXTURE_2D,i),r.texStorage2D(r.TEXTURE_2D,1,e,1024,t),r.texParameteri(r.TEXTURE_2D,r.TEXTURE_MIN_FILTER,r.NEAREST),r.texParameteri(r.TEXTURE_2D,r.TEXTURE_MAG_FILTER,r.NEAREST),i}};function zt(n,e,t){let{viewmat:r,fx:i,fy:s,cx:o,cy:a,width:l,height:c}=t,u=.15*l/i,d=.15*c/s;n.uniformMatrix4fv(e.at("uView"),!0,r),n.uniform3fv(e.at("uEye"),A(r)),n.uniform4f(e.at("uLens"),i,s,o,a),n.uniform4f(e.at("uRange"),-o/i-u,(l-o)/i+u,-a/s-d,(c-a)/s+d),n.uniform2f(e.at("uSize"),l,c),n.uniform1f(e.at("uNear"),t.near)}function Gt(){let n=new Uint16Array(6*1024);for(let e=0;e<1024;e++)n.set([0,1,2,2,1,3].map(t=>4*e+t),6*e);return n}var ae=class{constructor(e,t,r){this.gl=e;this.program=e.createProgram();let i=[rt(e,e.VERTEX_SHADER,t),rt(e,e.FRAGMENT_SHADER,r)];for(let s of i)e.attachShader(this.program,s);e.linkProgram(this.program);for(let s of i)e.deleteShader(s);if(!e.getProgramParameter(this.program,e.LINK_STATUS)&&!e.isContextLost())throw new b(`This device's graphics driver refuses the player's shaders: ${e.getProgramInfoLog(this.program)}`)}gl;program;locations=new Map;use(){this.gl.useProgram(this.program)}at(e){let t=this.locations.get(e);return t===void 0&&this.locations.set(e,t=this.gl.getUniformLocation(this.program,e)),t}texture(e,t,r,i){let{gl:s}=this;s.activeTexture(s.TEXTURE0+t),s.bindTexture(r,i),s.uniform1i(this.at(e),t)}delete(){this.gl.deleteProgram(this.program)}};function rt(n,e,t){let r=n.createShader(e);if(n.shaderSource(r,t),n.compileShader(r),!n.getShaderParameter(r,n.COMPILE_STATUS)&&!n.isContextLost())throw new b(`This device's graphics driver refuses the player's shaders: ${n.getShaderInfoLog(r)}`);return r}function le(n){return new Worker(new URL(n,import.meta.url))}var ce=class{worker=le("sort-worker.js");waiting=null;spare=null;constructor(e){this.worker.onmessage=({data:t})=>{let r=this.waiting;this.waiting=null,r?.(t)},this.worker.onerror=t=>e(`Sorting failed (${t.message}).`)}get busy(){return this.waiting!==null}addLayer(e,t,r){let{means:i}=r.points;this.post({type:"layer",index:e,layer:{base:t,means:i}},[i.buffer])}addGroup(e,t,r){let{means:i}=r.points,{dx:s,dxMin:o,dxStep:a,frames:l}=r.offsets??{dx:new Uint16Array,dxMin:[0,0,0],dxStep:[0,0,0],frames:1},c={base:t,means:i,frames:l,dx:s,dxMin:o,dxStep:a,alive:r.alive};this.post({type:"group",index:e,group:c},[i.buffer,s.buffer])}dropGroup(e){this.post({type:"drop",index:e})}sort(e,t){let[,,,,,,,,r,i,s,o]=t.viewmat,a=this.spare;return this.spare=null,new Promise(l=>{this.waiting=l,this.post({type:"sort",scene:e,axis:[r,i,s,o],near:t.near,buffer:a},a?[a.buffer]:[])})}recycle(e){this.spare=e}destroy(){this.worker.terminate()}post(e,t=[]){this.worker.postMessage(e,t)}};var ue=class{constructor(e,t,r){this.manifest=t;this.renderer=new oe(e),this.sorter=new ce(i=>r(new Error(i)))}manifest;scene=null;sortMilliseconds=0;pictures=0;renderer;sorter;drawnFrame=0;unsorted=!0;dirty=!1;closed=!1;addLayer(e,t){this.sorter.addLayer(e,this.renderer.addLayer(e,t),t),this.invalidate()}addGroup(e,t){this.sorter.addGroup(e,this.renderer.addGroup(e,t),t),this.invalidate()}dropGroup(e){this.renderer.dropGroup(e),this.sorter.dropGroup(e)}get lost(){return this.renderer.lost}get points(){return this.renderer.drawn}invalidate(){this.dirty=!0,this.unsorted=!0}get wantsSort(){return this.unsorted&&!this.sorter.busy}async settled(){for(;this.sorter.busy;)await new Promise(e=>setTimeout(e,1))}async sort(e,t){this.unsorted=!1;let r=await this.sorter.sort(e,t);return this.closed||!this.renderer.holds(e)?!1:(this.sortMilliseconds=r.milliseconds,this.renderer.setOrder(r.order,r.count),this.sorter.recycle(r.order),this.scene=e,this.dirty=!0,!0)}draw(e,t){let{scene:r,manifest:i}=this;if(!this.dirty||!r)return;if(this.dirty=!1,this.pictures++,r.current===null)return this.renderer.draw(r,1,t);let{groups:s,overlap:o}=i,{group:a}=r.current,{firstFrame:l,frames:c}=s[a],u=e!==null&&e>=l&&e<=l+c-1;e!==null&&(u||be(s,e)===a)&&(this.drawnFrame=e);let d=ve(s,o,this.drawnFrame,a),m=r.previous&&{group:r.previous.group,frame:K(s[r.previous.group],this.drawnFrame)};this.renderer.draw({...r,current:d.current,previous:m},m?d.weight:1,t)}async snapshot(e,t,r){if(await this.settled(),!await this.sort(e,r))throw new Error("The reel was closed.");return this.renderer.draw(e,t,r),{width:r.width,height:r.height,data:this.renderer.readPixels()}}depthAt(e,t){return this.scene?this.renderer.depthAt(this.scene,e,t):null}destroy(){this.closed=!0,this.sorter.destroy(),this.renderer.destroy()}};function it({stage:n,stream:e,manifest:t,canvas:r,resolution:i,ahead:s,currentTime:o}){let{groups:a,fps:l,frames:c}=t,u=Math.max(a.findLastIndex(m=>m.firstFrame<=o*l),0),d=((a[u+1]?.firstFrame??c)-a[u].firstFrame)/l;return{fps:1e3/i.interval,points:n.points,width:r.width,height:r.height,bitrate:8*a[u].bytes/d,throughput:e.throughput,ahead:s,decodeMilliseconds:e.decodeMilliseconds,sortMilliseconds:n.sortMilliseconds}}function nt(n){let e=r=>`${(r/1e6).toFixed(1)} Mbit/s`,t=r=>`${r.toFixed(r<10?1:0)} ms`;return[["Pictures",`${n.fps.toFixed(0)} fps, ${n.width} × ${n.height}`],["Points",n.points.toLocaleString("en")],["Bitrate",e(n.bitrate)],["Network",n.throughput>0?e(n.throughput):"–"],["Buffer",`${n.ahead.toFixed(1)} s`],["Decode",t(n.decodeMilliseconds)],["Sort",t(n.sortMilliseconds)]]}var Bt=2,Ht=8,qt=1e4,he=class{constructor(e,t,r){this.manifest=e;this.budget=t;this.events=r;this.workers=Array.from({length:Bt},()=>le("decode-worker.js")),this.idle=[...this.workers]}manifest;budget;events;trouble=null;throughput=0;decodeMilliseconds=0;workers;idle;jobs=new Map;layers=new Set;groups=new Set;resting=new Map;demand={current:0,previous:null,inUse:[],loop:!1};nextId=0;stopped=!1;get layersReady(){let e=0;for(;this.layers.has(e);)e++;return e}layersOf(e){return this.manifest.layers.filter(t=>t.group<=e).length}has(e){return this.groups.has(e)&&this.layersReady>=this.layersOf(e)}get held(){return[...this.groups].sort((e,t)=>e-t)}get buffered(){let{groups:e,frames:t,fps:r}=this.manifest,i=[];for(let s of this.held.filter(o=>this.has(o))){let o=e[s].firstFrame/r,a=(e[s+1]?.firstFrame??t)/r,l=i.at(-1);l&&Math.abs(l[1]-o)<1e-6?l[1]=a:i.push([o,a])}return i}want(e){this.demand=e,this.fill()}destroy(){for(let e of this.workers)e.terminate()}fill(){if(this.stopped)return;let e=this.queue(),t=new Set(e.map(i=>i.key));for(let i of this.jobs.values())t.has(i.wanted.key)||this.cancel(i);let r=!1;for(let i of e){let s=this.isNeededNow(i);if(r&&!s)return;if(!(i.kind==="layer"?this.layers:this.groups).has(i.index)&&(r||=s,!(this.jobs.has(i.key)||!s&&(this.resting.get(i.key)??0)>performance.now()))){if(this.idle.length===0){let o=[...this.jobs.values()].find(a=>!this.isNeededNow(a.wanted));s&&o&&this.cancel(o);return}if(i.kind==="group"&&!this.makeRoom(i,e)&&!s)return;this.load(i)}}}isNeededNow({kind:e,index:t}){let{current:r,previous:i}=this.demand;return e==="layer"?this.manifest.layers[t].group<=r:t===r||t===i}queue(){let{manifest:e,demand:t}=this,{current:r,previous:i,loop:s}=t,{groups:o,fps:a}=e,l=(m,h)=>e.layers.flatMap((p,f)=>p.group>=m&&p.group<=h?[Xt(f)]:[]),c=[...l(0,r),Te(r)];i!==null&&c.push(Te(i));let u=this.budget-I(o[r])-(i===null?0:I(o[i])),d=0;for(let m=1;m<o.length&&d<Ht&&!(r+m>=o.length&&!s);m++){let h=(r+m)%o.length;if(h!==i){if(u-=I(o[h]),u<0&&m>1)break;c.push(...l(r+1,h),Te(h)),d+=o[h].frames/a}}return c}makeRoom(e,t){let{groups:r}=this.manifest,i=p=>p.reduce((f,w)=>f+I(r[w]),0),s=p=>p.filter(({kind:f})=>f==="group").map(({index:f})=>f),o=s(t),a=Math.max(this.budget,i(o)),l=s([...this.jobs.values()].map(p=>p.wanted)),c=i([...this.groups,...l,e.index]),{current:u,inUse:d}=this.demand,m=p=>(u-p+r.length)%r.length,h=this.held.filter(p=>!o.includes(p)&&!d.includes(p)).sort((p,f)=>m(p)-m(f));for(;c>a&&h.length>0;){let p=h.pop();c-=I(r[p]),this.groups.delete(p),this.events.dropped(p)}return c<=a}load(e){let t=this.idle.pop(),r={id:this.nextId++,wanted:e,worker:t,began:performance.now(),received:0};this.jobs.set(e.key,r);let i=this.fileOf(e);t.onmessage=({data:o})=>{o.id===r.id&&("received"in o?this.received(r,o.received):"trouble"in o?this.troubled(o.trouble):this.finish(r,()=>"file"in o?this.deliver(r,o.file,o.milliseconds):this.failed(e,o.error)))},t.onerror=o=>this.finish(r,()=>this.failed(e,`${i.uri} cannot be decoded (${o.message}).`));let s=new URL(i.uri,this.manifest.url).href;this.tell(r,{id:r.id,source:{url:s,bytes:i.bytes,sha256:i.sha256}})}cancel(e){this.jobs.delete(e.wanted.key),this.tell(e,{id:e.id,cancel:!0});let t=()=>{this.idle.push(e.worker),this.fill()};e.worker.onmessage=({data:r})=>{("file"in r||"error"in r)&&t()},e.worker.onerror=t}finish(e,t){this.jobs.delete(e.wanted.key),this.idle.push(e.worker),t(),this.fill()}received(e,t){e.received===0&&(e.began=performance.now()),e.received+=t,this.troubled(null)}troubled(e){this.trouble=e,this.events.progress()}failed(e,t){this.isNeededNow(e)?(this.stopped=!0,this.events.failed(new b(t))):this.resting.set(e.key,performance.now()+qt)}deliver(e,t,r){let{kind:i,index:s}=e.wanted,o=(performance.now()-e.began-r)/1e3;o>0&&(this.throughput=8*e.received/o),this.decodeMilliseconds=r,(i==="layer"?this.layers:this.groups).add(s),this.events[i](s,t)}fileOf({kind:e,index:t}){return(e==="layer"?this.manifest.layers:this.manifest.groups)[t]}tell(e,t){e.worker.postMessage(t)}};function I(n){return n.points*(92+24*n.frames)}function st(){let n=navigator.deviceMemory??2;return Math.min(Math.max(n,1),8)*2**26}function Xt(n){return{kind:"layer",index:n,key:`layer ${n}`}}function Te(n){return{kind:"group",index:n,key:`group ${n}`}}function Ee(n,e,t){return new Promise((r,i)=>{let s=()=>{if(n.error)i(n.error);else if(t())r();else return;n.removeEventListener(e,s),n.removeEventListener("error",s)};n.addEventListener(e,s),n.addEventListener("error",s),s()})}var jt=.25,$=class extends EventTarget{constructor(t){super();this.canvas=t;t.addEventListener("webglcontextlost",r=>{r.preventDefault(),this.fail(new C)}),t.addEventListener("webglcontextrestored",()=>this.retry())}canvas;camera=null;error=null;resolution=new ee;stage=null;stream=null;source="";start=null;clock=new Y;stalled=!0;isSeeking=!1;ready=!1;trouble=null;held=!1;lastTick=0;tickRequest=0;session=new AbortController;online=()=>{this.error&&this.retry()};connect(){addEventListener("online",this.online);let t=r=>{this.tickRequest=requestAnimationFrame(t),this.tick(r)};this.tickRequest=requestAnimationFrame(t)}disconnect(){removeEventListener("online",this.online),cancelAnimationFrame(this.tickRequest),this.close()}load(t,r=null){return this.source=t,this.start=r,this.begin()}retry(){this.camera&&(this.start={seconds:this.currentTime,view:this.camera.state}),this.begin()}async begin(){this.close(),this.emit("loadstart");let{source:t,session:{signal:r}}=this,i={received:()=>{},trouble:s=>this.troubled(s)};try{let s=await Z(t,i,r);for(;s.groups.length===0;)this.troubled("Live. The first group is not here yet."),s=await we(s,r);r.aborted||this.open(s)}catch(s){r.aborted||this.fail(s)}}close(){this.session.abort(),this.session=new AbortController,this.stream?.destroy(),this.stage?.destroy(),[this.stream,this.stage,this.clock.manifest,this.camera]=[null,null,null,null],[this.error,this.trouble,this.ready,this.stalled,this.isSeeking]=[null,null,!1,!0,!1]}get manifest(){return this.clock.manifest}get duration(){return this.clock.duration}get live(){return this.clock.live}get edge(){return this.clock.edge}get currentTime(){return this.clock.seconds}set currentTime(t){this.clock.seek(t),this.isSeeking=!0,this.emit("seeking"),this.emit("timeupdate"),this.update(),this.invalidate()}get loop(){return this.clock.loop}set loop(t){this.clock.loop=t}get playbackRate(){return this.clock.rate}set playbackRate(t){this.clock.rate=t,this.emit("ratechange")}get paused(){return!this.clock.playing}get seeking(){return this.isSeeking}get ended(){return this.clock.ended}get waiting(){return this.stalled}get notice(){return this.trouble??this.stream?.trouble??null}get canPlay(){return this.ready}get buffered(){return this.stream?.buffered??[]}get ahead(){let{seconds:t}=this.clock,r=this.buffered.find(([i,s])=>i<=t&&t<=s);return r?r[1]-t:0}get stats(){return this.stage&&this.stream&&this.manifest?it(this):null}play(){this.clock.playing||(this.ended&&(this.currentTime=0),this.clock.playing=!0,this.emit("play"))}pause(){this.clock.playing&&(this.clock.playing=!1,this.emit("pause"))}step(t){this.manifest&&(this.pause(),this.currentTime=this.clock.framesOn(t))}invalidate(){this.stage?.invalidate()}focusAt(t,r){let{camera:i,stage:s,canvas:o}=this,a=this.viewNow();if(!i||!s||!a)return;let l=a.width/o.clientWidth,c=s.depthAt(t*l,r*l);c!==null&&i.focus([(t*l-a.cx)/a.fx*c,(r*l-a.cy)/a.fy*c,c])}whenReady(){return Ee(this,"canplay",()=>this.ready)}async renderAt(t,r,i,s){if(await this.whenReady(),this.pause(),this.currentTime=t,await Ee(this,"seeked",()=>!this.isSeeking),!this.stage)throw new Error("The reel was closed.");this.held=!0;try{let o=this.clock.moment,{K:a,viewmat:l}=r,c={viewmat:l,fx:a[0],fy:a[4],cx:a[2],cy:a[5],width:i,height:s,near:this.manifest.near};return await this.stage.snapshot(this.sceneOf(o),o.weight,c)}finally{this.held=!1,this.invalidate()}}open(t){this.trouble=null,this.clock.manifest=t,this.camera=new j(t),this.camera.calm=matchMedia("(prefers-reduced-motion: reduce)").matches;let r=new ue(this.canvas,t,o=>this.fail(o));this.stage=r;let i=o=>{if(!this.error){try{o()}catch(a){return this.fail(a)}this.emit("progress"),this.update()}};this.stream=new he(t,st(),{layer:(o,a)=>i(()=>r.addLayer(o,a)),group:(o,a)=>i(()=>r.addGroup(o,a)),dropped:o=>(r.dropGroup(o),this.emit("progress")),progress:()=>this.emit("progress"),failed:o=>this.fail(o)}),this.start?.view&&(this.camera.state=this.start.view),this.clock.seek(this.start?.seconds??(t.live?this.edge:0)),this.emit("loadedmetadata"),this.emit("durationchange"),this.update(),qe(t,()=>{this.emit("durationchange"),this.update()},this.session.signal)}troubled(t){this.trouble=t,this.emit("progress")}fail(t){if(this.error)return;let r=this.stage?.lost?new C:t;this.error=r instanceof Error?r:new Error(O(r)),this.emit("error")}emit(t){this.dispatchEvent(new Event(t))}sceneOf({current:t,previous:r}){return{layers:this.stream.layersOf(t.group),current:t,previous:r}}update(){let{stream:t,stage:r}=this;if(!t||!r||this.error)return;let{current:i,previous:s}=this.clock.moment,o=[r.scene?.current?.group,r.scene?.previous?.group].filter(l=>l!==void 0);t.want({current:i.group,previous:s?.group??null,inUse:o,loop:this.loop&&!this.live});let a=t.has(i.group)&&(s===null||t.has(s.group));a===this.stalled&&(this.stalled=!a,this.emit(a?"playing":"waiting"))}tick(t){let r=Math.min((t-this.lastTick)/1e3,jt);this.lastTick=t;let{stage:i,camera:s}=this;if(!i||!s||this.held)return;this.advance(r),s.step(r)&&this.invalidate();let o=this.viewNow();if(!o)return;i.wantsSort&&this.startSort(i,o);let a=i.pictures;i.draw(this.isSeeking||this.stalled?null:this.clock.frame,o),this.resolution.drawn(i.pictures>a,t)}advance(t){this.paused||!this.ready||this.stalled||this.isSeeking||this.error||this.clock.advance(t)&&(this.emit("timeupdate"),this.update(),this.invalidate(),this.ended&&!this.loop&&(this.pause(),this.emit("ended")))}viewNow(){let t=this.resolution.ratio,r=Math.round(this.canvas.clientWidth*t),i=Math.round(this.canvas.clientHeight*t);return r>0&&i>0?this.camera.view(r,i):null}startSort(t,r){let i=this.stream.layersReady;this.stalled?!t.scene?.current&&i>0&&this.show(t,{layers:i,current:null,previous:null},r):this.show(t,this.sceneOf(this.clock.moment),r)}async show(t,r,i){!await t.sort(r,i)||this.stalled||r.current===null||(this.isSeeking&&r.current.group===this.clock.moment.current.group&&(this.isSeeking=!1,this.emit("seeked"),this.update()),!this.ready&&(this.ready=!0,this.emit("canplay")))}};var ot=`:host {
  --accent: #4f8cff;
  --surface: rgb(24 24 27 / 0.9);
  --text: #f4f4f5;
  --muted: rgb(244 244 245 / 0.62);
  --line: rgb(255 255 255 / 0.12);
  --ground: #0b0b0c;
  position: relative;
  display: block;
  overflow: hidden;
  background: var(--ground);
  color: #f4f4f5;
  font: 500 13px/1.4 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  text-align: start;
  -webkit-tap-highlight-color: transparent;
  -webkit-user-select: none;
  user-select: none;
  aspect-ratio: 16 / 9;
  container-type: size;
}
:host(.filling) { position: fixed !important; inset: 0; z-index: 2147483647; width: 100% !important; height: 100% !important; }
* { box-sizing: border-box; }
[hidden] { display: none !important; }
canvas, .poster { display: block; width: 100%; height: 100%; }
canvas { touch-action: none; cursor: grab; outline: none; }
canvas:active { cursor: grabbing; }
canvas:focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
:host(.idle) canvas { cursor: none; }
.poster { position: absolute; inset: 0; object-fit: cover; pointer-events: none; }
.ui { position: absolute; inset: 0; pointer-events: none; }

/* The bar, over the picture and so the same on light and dark pages. */
.bar {
  position: absolute;
  inset: auto 0 0;
  padding: 64px max(14px, env(safe-area-inset-right)) max(8px, env(safe-area-inset-bottom)) max(14px, env(safe-area-inset-left));
  background: linear-gradient(transparent, rgb(0 0 0 / 0.28) 45%, rgb(0 0 0 / 0.74));
  transition: opacity 0.25s ease, transform 0.25s ease;
}
.bar > * { pointer-events: auto; }
:host(.idle) .bar { opacity: 0; transform: translateY(6px); }
.row { display: flex; align-items: center; gap: 2px; margin: 0 -8px; }
.gap { flex: 1; }
.time { margin-left: 6px; font-variant-numeric: tabular-nums; white-space: nowrap; }
.time span { color: rgb(255 255 255 / 0.6); }

button, select { color: inherit; font: inherit; cursor: pointer; }
button {
  display: inline-flex;
  align-items: center;
  justify-content: center;
  width: 40px;
  height: 40px;
  padding: 0;
  border: 0;
  border-radius: 10px;
  background: none;
  pointer-events: auto;
  transition: background 0.15s ease;
}
button:hover { background: rgb(255 255 255 / 0.14); }
button:active { background: rgb(255 255 255 / 0.22); }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 1px; }
svg { width: 20px; height: 20px; fill: none; stroke: currentColor; stroke-width: 1.75; stroke-linecap: round; stroke-linejoin: round; }
svg .solid { fill: currentColor; }
.settings[aria-expanded="true"] { background: rgb(255 255 255 / 0.18); }
.live { width: auto; height: 26px; margin-left: 10px; padding: 0 9px 0 8px; gap: 6px; border-radius: 7px; font-size: 12px; background: rgb(255 255 255 / 0.14); }
.live::before { content: ""; width: 7px; height: 7px; border-radius: 50%; background: rgb(255 255 255 / 0.6); }
.live.on::before { background: #ff4d4f; }

.track { position: relative; }
.hint {
  position: absolute;
  bottom: 22px;
  padding: 2px 7px;
  border-radius: 6px;
  background: rgb(0 0 0 / 0.72);
  font-size: 12px;
  font-variant-numeric: tabular-nums;
  translate: -50%;
  opacity: 0;
  pointer-events: none;
  transition: opacity 0.12s ease;
}
@media (hover: hover) { .track:hover .hint { opacity: 1; } }
.seek {
  --played: 0%;
  --ahead: linear-gradient(transparent, transparent);
  --track: linear-gradient(to right, #fff var(--played), transparent var(--played)), var(--ahead), rgb(255 255 255 / 0.22);
  display: block;
  width: 100%;
  height: 22px;
  margin: 0;
  border-radius: 6px;
  background: none;
  appearance: none;
  cursor: pointer;
}
.seek::-webkit-slider-runnable-track { height: 4px; border-radius: 2px; background: var(--track); }
.seek::-moz-range-track { height: 4px; border-radius: 2px; background: var(--track); }
.seek::-webkit-slider-thumb {
  width: 14px;
  height: 14px;
  margin-top: -5px;
  border-radius: 50%;
  background: #fff;
  box-shadow: 0 1px 4px rgb(0 0 0 / 0.5);
  appearance: none;
  scale: 0;
  transition: scale 0.12s ease;
}
.seek::-moz-range-thumb { width: 14px; height: 14px; border: 0; border-radius: 50%; background: #fff; }
.seek:is(:hover, :active, :focus-visible)::-webkit-slider-thumb { scale: 1; }
@media (hover: none) { .seek::-webkit-slider-thumb { scale: 1; } }

/* In the middle: waiting, the first play, errors, short messages. */
.center { position: absolute; inset: 0; display: grid; place-items: center; padding: 24px; }
.center > * { grid-area: 1 / 1; }
.wait { display: grid; justify-items: center; gap: 14px; text-align: center; }
.wait p { margin: 0; max-width: 36ch; padding: 4px 12px; border-radius: 10px; background: rgb(0 0 0 / 0.55); opacity: 0; overflow-wrap: anywhere; transition: opacity 0.25s ease; }
.wait.long p { opacity: 1; }
.spinner {
  width: 42px;
  height: 42px;
  border: 3px solid rgb(140 140 150 / 0.35);
  border-top-color: #fff;
  border-radius: 50%;
  opacity: 0;
  animation: turn 0.9s linear infinite, appear 0.2s ease 0.25s forwards;
}
@keyframes turn { to { rotate: 1turn; } }
@keyframes appear { to { opacity: 1; } }
.start { width: 72px; height: 72px; border-radius: 50%; background: rgb(20 20 22 / 0.6); backdrop-filter: blur(8px); }
.start:hover { background: rgb(50 50 56 / 0.7); }
.start svg { width: 30px; height: 30px; }
.toast { place-self: start center; padding: 7px 14px; border-radius: 10px; background: rgb(0 0 0 / 0.72); opacity: 0; transition: opacity 0.2s ease; }
.toast.shown { opacity: 1; }

/* Sheets, which follow the colour scheme. */
.sheet {
  pointer-events: auto;
  border: 1px solid var(--line);
  border-radius: 14px;
  background: var(--surface);
  color: var(--text);
  backdrop-filter: blur(16px) saturate(1.4);
  box-shadow: 0 8px 30px rgb(0 0 0 / 0.25);
}
.sheet button:hover { background: var(--line); }
.sheet h2 { margin: 0 0 6px; font-size: 15px; font-weight: 600; }
.panel { max-width: min(420px, 100%); max-height: 100%; padding: 22px; overflow: auto; text-align: center; }
.panel p { margin: 0 0 18px; color: var(--muted); font-weight: 400; overflow-wrap: anywhere; }
.panel button { width: auto; height: 36px; padding: 0 18px; background: var(--text); color: var(--ground); font-weight: 600; }
.panel button:hover { background: var(--text); opacity: 0.86; }

.stats { position: absolute; top: 12px; left: 12px; display: grid; grid-template-columns: auto auto; gap: 1px 14px; margin: 0; padding: 9px 13px; pointer-events: none; font-size: 12px; font-variant-numeric: tabular-nums; }
dt { color: var(--muted); }
dd { margin: 0; }
.stats dd { text-align: end; }

.menu { position: absolute; right: 12px; bottom: 84px; width: min(280px, 100cqw - 24px); max-height: calc(100cqh - 100px); padding: 6px; overflow: auto; }
.menu > * { display: flex; align-items: center; justify-content: space-between; width: 100%; min-height: 34px; padding: 0 10px; border-radius: 9px; }
.menu .frames { padding-right: 2px; }
.menu .frames button, .menu .wide { height: 34px; }
.menu .wide { justify-content: flex-start; text-align: start; }
.menu label { cursor: pointer; }
.menu label:hover { background: var(--line); }
select { padding: 4px 6px; border: 0; border-radius: 7px; background: none; text-align: end; text-align-last: end; }
option { color: #111; background: #fff; }
[role="switch"] { position: relative; width: 34px; height: 20px; margin: 0; border-radius: 10px; background: var(--line); appearance: none; cursor: pointer; transition: background 0.15s ease; }
[role="switch"]::before { content: ""; position: absolute; top: 2px; left: 2px; width: 16px; height: 16px; border-radius: 50%; background: #fff; box-shadow: 0 1px 2px rgb(0 0 0 / 0.4); transition: translate 0.15s ease; }
[role="switch"]:checked { background: var(--accent); }
[role="switch"]:checked::before { translate: 14px; }

.help { position: absolute; inset: 12px; width: fit-content; height: fit-content; max-width: calc(100% - 24px); max-height: calc(100% - 24px); margin: auto; padding: 18px 20px; overflow: auto; font-weight: 400; }
.help .close { position: absolute; top: 8px; right: 8px; }
.help h3 { margin: 8px 0 4px; color: var(--muted); font-size: 12px; font-weight: 500; }
.help dl { display: grid; grid-template-columns: auto 1fr; gap: 4px 14px; margin: 0; align-items: baseline; }
.help dt { white-space: nowrap; }
.help p { max-width: 66ch; margin: 12px 0 0; color: var(--muted); }
.columns { display: flex; flex-wrap: wrap; gap: 4px 28px; }
kbd { display: inline-block; min-width: 20px; padding: 0 5px; border: 1px solid var(--line); border-radius: 5px; background: var(--line); color: var(--text); font: inherit; font-size: 11px; text-align: center; }

@media (prefers-color-scheme: light) {
  :host {
    --surface: rgb(255 255 255 / 0.92);
    --text: #18181b;
    --muted: rgb(24 24 27 / 0.62);
    --line: rgb(0 0 0 / 0.1);
    --ground: #f1f1f3;
  }
}
@container (max-width: 400px) {
  .bar { padding-left: 12px; padding-right: 12px; }
  .row { gap: 0; }
  .columns { flex-direction: column; }
}
@media (prefers-reduced-motion: reduce) {
  * { transition: none !important; }
  .spinner { animation-duration: 2.4s, 0.01s; }
}
`;var S=n=>`<svg viewBox="0 0 24 24" aria-hidden="true">${n}</svg>`,de=S('<path class="solid" d="M8 5.5v13l10.5-6.5z"/>'),at=S('<path d="M8.5 5.5v13M15.5 5.5v13" stroke-width="3"/>'),lt=S('<path d="M4 12a8 8 0 1 0 2.6-5.9L4 8.5M4 4v4.5h4.5"/>'),ct=S('<path d="M4 7h9M19 7h1M4 17h1M11 17h9"/><circle cx="16" cy="7" r="2.5"/><circle cx="8" cy="17" r="2.5"/>'),ke=S('<path d="M9 4H4v5M15 4h5v5M9 20H4v-5M15 20h5v-5"/>'),ut=S('<path d="M4 9h5V4M20 9h-5V4M4 15h5v5M20 15h-5v5"/>'),ht=S('<path d="M14.5 6.5 9 12l5.5 5.5"/>'),dt=S('<path d="M9.5 6.5 15 12l-5.5 5.5"/>'),pt=S('<path d="M6.5 6.5l11 11M17.5 6.5l-11 11"/>');var Se=[.25,.5,.75,1,1.25,1.5,2];function mt(n,e,t,r){let i=[["Time",Jt(e,t)],["View",Zt(e,t)]],s=new Map;for(let[,l]of i)for(let c of l)for(let u of c.bindings)for(let d of u.keys)s.set(d,u);let o=new Map,a=()=>{if(!e.camera)return;let l={yaw:0,pitch:0,right:0,down:0,forward:0,zoom:0};for(let c of o.values())for(let[u,d]of Object.entries(c))l[u]+=d;e.camera.thrust=l};return n.addEventListener("keydown",l=>{if(l.ctrlKey||l.metaKey||l.altKey||Yt(l))return;let c=Qt(l),u=s.get(c);u&&(l.preventDefault(),u.thrust&&o.set(l.code,u.thrust),u.press?.(c),a())},{signal:r}),n.addEventListener("keyup",l=>(o.delete(l.code),a()),{signal:r}),n.addEventListener("focusout",()=>(o.clear(),a()),{signal:r}),i}function Yt(n){let e=n.composedPath()[0];return e instanceof HTMLSelectElement?n.key!=="Escape":e instanceof HTMLInputElement&&e.type==="checkbox"?n.key===" ":e instanceof HTMLButtonElement&&(n.key===" "||n.key==="Enter")}function Qt({key:n,shiftKey:e}){return n.startsWith("Arrow")&&e?`shift+${n.toLowerCase()}`:n.toLowerCase()}function Jt(n,e){let t=(i,s)=>()=>{n.currentTime+=Math.sign(i)*Math.min(Math.abs(i)*n.duration,s)},r=i=>()=>{let s=Se.findIndex(o=>o>=n.playbackRate);n.playbackRate=Se[Math.min(Math.max(s+i,0),Se.length-1)]};return[{shown:"Space K",what:"Play or pause",bindings:[{keys:[" ","k"],press:e.toggle}]},{shown:"← →",what:"Back or on, up to 5 s",bindings:[{keys:["arrowleft"],press:t(-.1,5)},{keys:["arrowright"],press:t(.1,5)}]},{shown:"J L",what:"Back or on, up to 10 s",bindings:[{keys:["j"],press:t(-.2,10)},{keys:["l"],press:t(.2,10)}]},{shown:", .",what:"One frame",bindings:[{keys:[","],press:()=>n.step(-1)},{keys:["."],press:()=>n.step(1)}]},{shown:"0 – 9",what:"To tenths of the reel",bindings:[{keys:[..."0123456789"],press:i=>{n.currentTime=Number(i)/10*n.duration}}]},{shown:"Home End",what:"To the ends",bindings:[{keys:["home"],press:()=>{n.currentTime=0}},{keys:["end"],press:()=>{n.currentTime=n.duration}}]},{shown:"< >",what:"Slower or faster",bindings:[{keys:["<"],press:r(-1)},{keys:[">"],press:r(1)}]}]}function Zt(n,e){let t=(r,i,s)=>[{keys:[r[0]],thrust:{[i]:-s}},{keys:[r[1]],thrust:{[i]:s}}];return[{shown:"W A S D",what:"Walk",bindings:[...t(["s","w"],"forward",.6),...t(["a","d"],"right",.6)]},{shown:"Q E",what:"Down, up",bindings:t(["e","q"],"down",.6)},{shown:"Shift ← → ↑ ↓",what:"Turn about the middle",bindings:[...t(["shift+arrowleft","shift+arrowright"],"yaw",1.2),...t(["shift+arrowup","shift+arrowdown"],"pitch",1.2)]},{shown:"+ −",what:"Nearer, farther",bindings:[...t(["+","-"],"zoom",1.2),{keys:["="],thrust:{zoom:-1.2}}]},{shown:"[ ]",what:"Cameras of the capture",bindings:[{keys:["["],press:()=>n.camera?.visit(-1)},{keys:["]"],press:()=>n.camera?.visit(1)}]},{shown:"C",what:"Fly through them",bindings:[{keys:["c"],press:e.fly}]},{shown:"R",what:"Reset the view",bindings:[{keys:["r"],press:e.reset}]},{shown:"F",what:"Fullscreen",bindings:[{keys:["f"],press:e.fullscreen}]},{shown:"I",what:"Statistics",bindings:[{keys:["i"],press:e.statistics}]},{shown:"?",what:"These keys",bindings:[{keys:["?"],press:e.help}]},{shown:"Esc",what:"Close",bindings:[{keys:["escape"],press:e.escape}]}]}var er=[.25,.5,.75,1,1.25,1.5,2],tr=[["auto","Automatic"],["full","Full"],["half","Half"]],ft=(n,e)=>`<option value="${n}">${e}</option>`,gt=(n,e,t)=>`<label>${e}<select name="${n}">${t.join("")}</select></label>`,Me=(n,e)=>`<label>${e}<input type="checkbox" role="switch" name="${n}" /></label>`,rr=[gt("rate","Speed",er.map(n=>ft(n,`${n} ×`))),gt("quality","Resolution",tr.map(([n,e])=>ft(n,e))),Me("loop","Loop"),Me("fly","Fly through the cameras"),Me("statistics","Statistics"),`<div class="frames">Frame<span><button type="button" name="back" aria-label="One frame back">${ht}</button><button type="button" name="on" aria-label="One frame on">${dt}</button></span></div>`,'<button type="button" name="share" class="wide">Copy a link to this view</button>','<button type="button" name="help" class="wide">Keys and gestures</button>'].join(""),pe=class{constructor(e,t,r){this.box=e;this.player=t;e.innerHTML=rr,this.input("rate").onchange=()=>{t.playbackRate=Number(this.input("rate").value)},this.input("quality").onchange=()=>{t.resolution.quality=this.input("quality").value,t.invalidate()},this.input("loop").onchange=()=>r.loop(this.input("loop").checked),this.input("fly").onchange=()=>r.fly(),this.input("statistics").onchange=()=>r.statistics(),this.input("back").onclick=()=>t.step(-1),this.input("on").onclick=()=>t.step(1),this.input("share").onclick=()=>r.share(),this.input("help").onclick=()=>r.help()}box;player;statistics=!1;get open(){return!this.box.hidden}set open(e){this.box.hidden=!e,this.update()}update(){if(!this.open)return;let{player:e}=this;this.input("rate").value=String(e.playbackRate),this.input("quality").value=e.resolution.quality,this.input("loop").checked=e.loop,this.input("fly").checked=e.camera?.flying===!0,this.input("statistics").checked=this.statistics}input(e){return this.box.querySelector(`[name=${e}]`)}};var ir=2600,nr=1500,sr=2200,or=`
  <div class="center">
    <div class="wait" role="status" hidden><div class="spinner"></div><p>Loading</p></div>
    <button class="start" type="button" aria-label="Play" tabindex="-1" hidden>${de}</button>
    <div class="toast" role="status"></div>
    <div class="sheet panel" role="alert" hidden><h2>This reel cannot be played</h2><p></p><button type="button" class="retry">Try again</button></div>
  </div>
  <dl class="sheet stats" aria-label="Statistics" hidden></dl>
  <div class="bar" role="group" aria-label="Player controls">
    <div class="track"><input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" /><span class="hint" aria-hidden="true"></span></div>
    <div class="row">
      <button type="button" class="play" aria-label="Play">${de}</button>
      <div class="time" aria-hidden="true">0:00 <span>/ 0:00</span></div>
      <button type="button" class="live" hidden>Live</button>
      <div class="gap"></div>
      <button type="button" class="reset" aria-label="Reset view" title="Reset view (r)">${lt}</button>
      <button type="button" class="settings" aria-label="Settings" title="Settings" aria-expanded="false">${ct}</button>
      <button type="button" class="full" aria-label="Fullscreen" title="Fullscreen (f)">${ke}</button>
    </div>
  </div>
  <div class="sheet menu" role="group" aria-label="Settings" hidden></div>
  <div class="sheet help" role="dialog" aria-label="Keys" hidden><button type="button" class="close" aria-label="Close">${pt}</button></div>`,me=class{constructor(e,t,r){this.host=e;this.player=r;this.holder.className="ui",this.holder.innerHTML=or,t.append(this.holder),this.seek=this.find(".seek"),this.stops=[this.seek,...this.holder.querySelectorAll(".row button")],this.menu=new pe(this.find(".menu"),r,{fly:()=>this.fly(),statistics:()=>this.toggleStatistics(),help:()=>this.toggleHelp(),share:()=>this.share(),loop:i=>e.toggleAttribute("loop",i)}),this.listen(),this.listenToButtons(),this.stop(1),this.update()}host;player;holder=document.createElement("div");seek;stops;menu;life=new AbortController;fade=0;explain=0;toast=0;dragging=!1;remove(){this.life.abort(),this.holder.remove(),clearTimeout(this.fade)}find(e){return this.holder.querySelector(e)}listen(){let{player:e,host:t,seek:r,life:{signal:i}}=this,s=["loadstart","loadedmetadata","durationchange","canplay","play","pause","timeupdate","progress","waiting","playing"];for(let u of[...s,"seeking","seeked","ratechange","ended","error"])e.addEventListener(u,()=>this.update(),{signal:i});r.addEventListener("input",()=>{this.dragging=!0,e.currentTime=Number(r.value)}),r.addEventListener("change",()=>this.dragging=!1),this.find(".track").addEventListener("pointermove",u=>this.hint(u));for(let u of["pointermove","pointerdown","keydown","focusin"])t.addEventListener(u,()=>this.wake(),{signal:i});t.addEventListener("pointerleave",()=>this.sleep(),{signal:i}),document.addEventListener("fullscreenchange",()=>this.update(),{signal:i}),this.find(".bar").addEventListener("keydown",u=>this.rove(u));let o=setInterval(()=>this.showStatistics(),250);i.addEventListener("abort",()=>clearInterval(o));let c=mt(t,e,{toggle:()=>this.toggle(),fullscreen:()=>this.toggleFullscreen(),reset:()=>e.camera?.reset(),fly:()=>this.fly(),statistics:()=>this.toggleStatistics(),help:()=>this.toggleHelp(),escape:()=>this.closeSheets()},i).map(([u,d])=>`<section><h3>${u}</h3><dl>${d.map(({shown:m,what:h})=>`<dt>${ar(m)}</dt><dd>${h}</dd>`).join("")}</dl></section>`);this.find(".help").insertAdjacentHTML("beforeend",`<h2>Keys</h2><div class="columns">${c.join("")}</div>
      <p>Drag to turn, right or Shift drag or two fingers to move, scroll or pinch for nearer and farther, double-click to choose the middle.</p>`)}listenToButtons(){let{player:e}=this,t=(r,i)=>{this.find(r).onclick=i};t(".play",()=>this.toggle()),t(".start",()=>this.toggle()),t(".full",()=>this.toggleFullscreen()),t(".reset",()=>e.camera?.reset()),t(".live",()=>{e.currentTime=e.edge,e.play()}),t(".retry",()=>e.retry()),t(".settings",()=>this.openMenu(!this.menu.open)),t(".help .close",()=>this.toggleHelp()),this.player.canvas.addEventListener("pointerdown",()=>this.openMenu(!1),{signal:this.life.signal})}toggle(){this.player.paused?this.player.play():this.player.pause()}toggleFullscreen(){let{host:e}=this;document.fullscreenElement?document.exitFullscreen():e.requestFullscreen?e.requestFullscreen():e.classList.toggle("filling"),this.update()}fly(){let{camera:e}=this.player;e?.fly(!e.flying),this.menu.update()}toggleStatistics(){let e=this.find(".stats");e.hidden=!e.hidden,this.showStatistics(),this.menu.statistics=!e.hidden,this.menu.update()}showStatistics(){let e=this.find(".stats"),{stats:t}=this.player;!e.hidden&&t&&(e.innerHTML=nt(t).map(([r,i])=>`<dt>${r}</dt><dd>${i}</dd>`).join(""))}toggleHelp(){let e=this.find(".help");e.hidden=!e.hidden,this.openMenu(!1),e.hidden?this.player.canvas.focus():this.find(".help .close").focus()}closeSheets(){this.find(".help").hidden?this.menu.open?(this.openMenu(!1),this.find(".settings").focus()):this.host.classList.remove("filling"):this.toggleHelp()}openMenu(e){this.menu.open=e,this.find(".settings").setAttribute("aria-expanded",String(e))}async share(){let{link:e}=this.host;this.openMenu(!1);let t=await navigator.clipboard?.writeText(e).then(()=>!0,()=>!1);t||history.replaceState(null,"",e),this.say(t?"Link copied":"The link is in the address bar")}say(e){let t=this.find(".toast");t.textContent=e,t.classList.add("shown"),clearTimeout(this.toast),this.toast=window.setTimeout(()=>t.classList.remove("shown"),sr)}rove(e){let t=this.stops.filter(a=>!a.hidden),r=t.indexOf(e.composedPath()[0]);if(r<0||e.shiftKey)return;let i=r===0,o={ArrowUp:0,ArrowDown:Math.max(r,1),ArrowLeft:i?null:Math.max(r-1,1),ArrowRight:i?null:Math.min(r+1,t.length-1)}[e.key]??null;o!==null&&(e.preventDefault(),e.stopPropagation(),this.stop(this.stops.indexOf(t[o])),t[o].focus())}stop(e){for(let[t,r]of this.stops.entries())r.tabIndex=t===e?0:-1}hint(e){let{left:t,width:r}=this.seek.getBoundingClientRect(),i=Math.min(Math.max((e.clientX-t)/r,0),1),s=this.find(".hint");s.textContent=V(i*this.player.duration,!0),s.style.left=`${Math.min(Math.max(i*r,24),r-24)}px`}wake(){this.host.classList.remove("idle"),clearTimeout(this.fade),this.fade=window.setTimeout(()=>this.sleep(),ir)}sleep(){let e=this.player.paused||this.player.error||this.dragging||this.menu.open||this.holder.matches(":has(:focus-visible)");this.host.classList.toggle("idle",!e)}update(){let{player:e,seek:t,host:r}=this,{duration:i,currentTime:s,paused:o,error:a,live:l}=e;this.find(".bar").hidden=e.manifest===null,this.find(".panel").hidden=!a,a&&(this.find(".panel p").textContent=a.message),this.updateWait(a===null&&(!e.canPlay||e.waiting)),this.find(".start").hidden=!(e.canPlay&&o&&s===0&&!a&&!e.waiting),t.max=String(i),this.dragging||(t.value=String(s)),t.setAttribute("aria-valuetext",`${V(s)} of ${V(i)}`),t.style.setProperty("--played",`${Re(s,i)}%`),t.style.setProperty("--ahead",this.bufferedTrack()),this.find(".time").innerHTML=`${V(s)} <span>/ ${V(i)}</span>`;let c=this.find(".live");c.hidden=!l,c.classList.toggle("on",s>=e.edge),bt(this.find(".play"),o?de:at,o?"Play":"Pause","k");let u=document.fullscreenElement!==null||r.classList.contains("filling");bt(this.find(".full"),u?ut:ke,u?"Leave fullscreen":"Fullscreen","f"),this.menu.update(),o||a?r.classList.remove("idle"):this.fade||this.wake()}updateWait(e){let t=this.find(".wait");e&&t.hidden&&(t.classList.remove("long"),this.explain=window.setTimeout(()=>t.classList.add("long"),nr)),e||clearTimeout(this.explain),t.hidden=!e;let r=this.player.notice??"Loading",i=t.querySelector("p");i.textContent!==r&&(i.textContent=r)}bufferedTrack(){let{buffered:e,duration:t}=this.player,r=e.flatMap(([i,s])=>{let[o,a]=[Re(i,t),Re(s,t)];return[`transparent ${o}%`,`rgb(255 255 255 / 0.36) ${o}%`,`rgb(255 255 255 / 0.36) ${a}%`,`transparent ${a}%`]});return r.length>0?`linear-gradient(to right, ${r.join(", ")})`:"linear-gradient(transparent, transparent)"}};function bt(n,e,t,r){n.getAttribute("aria-label")===t&&n.title||(n.innerHTML=e,n.setAttribute("aria-label",t),n.title=`${t} (${r})`)}function ar(n){return n.split(" ").map(e=>e==="–"?"–":`<kbd>${e.replace("<","&lt;")}</kbd>`).join(" ")}function Re(n,e){return e>0?Math.round(1e4*n/e)/100:0}function V(n,e=!1){let t=Math.floor(n+1e-6),r=e?`.${Math.floor((n-t+1e-6)*10)}`:"";return`${Math.floor(t/60)}:${String(t%60).padStart(2,"0")}${r}`}var vt=["loadstart","durationchange","loadedmetadata","canplay","play","playing","pause","waiting","timeupdate","progress"];vt.push("seeking","seeked","ratechange","ended","error");var fe=class extends HTMLElement{static observedAttributes=["src","poster","loop","controls"];player;canvas=document.createElement("canvas");picture=document.createElement("img");controlsShown=null;connection=new AbortController;constructor(){super();let e=document.createElement("style");e.textContent=ot,this.canvas.tabIndex=0,this.canvas.setAttribute("role","img"),this.picture.className="poster",this.picture.alt="",this.picture.hidden=!0,this.attachShadow({mode:"open"}).append(e,this.canvas,this.picture),this.player=new $(this.canvas);for(let t of vt)this.player.addEventListener(t,()=>this.dispatchEvent(new Event(t)));this.player.addEventListener("canplay",()=>this.picture.hidden=!0)}connectedCallback(){let{canvas:e,player:t}=this,r=this.getAttribute("aria-label")??"Volumetric video";e.setAttribute("aria-label",`${r}. Drag to look around, scroll to zoom, double-click to choose the middle.`),this.connection=new AbortController;let{signal:i}=this.connection;Pe(e,t,i);let s=new ResizeObserver(()=>t.invalidate());s.observe(e),i.addEventListener("abort",()=>s.disconnect()),addEventListener("hashchange",()=>this.hasAttribute("share")&&this.follow(location.href),{signal:i}),t.connect(),this.showControls(),this.load()}disconnectedCallback(){this.connection.abort(),this.controlsShown?.remove(),this.controlsShown=null,this.player.disconnect()}attributeChangedCallback(e,t,r){e==="loop"&&(this.player.loop=r!==null),!(!this.isConnected||t===r)&&(e==="src"&&this.load(),e==="poster"&&this.showPoster(),e==="controls"&&this.showControls())}load(){let{player:e}=this;if(this.showPoster(),!this.src)return e.close();e.load(this.currentSrc,this.hasAttribute("share")?ge(location.href):null);let t=matchMedia("(prefers-reduced-motion: reduce)").matches;this.autoplay&&!t&&e.play()}async play(){this.player.play(),await this.player.whenReady()}pause(){this.player.pause()}renderAt(e,t,r,i){return this.player.renderAt(e,t,r,i)}get src(){return this.getAttribute("src")??""}set src(e){this.setAttribute("src",e)}get currentSrc(){return this.src&&new URL(this.src,document.baseURI).href}get poster(){return this.getAttribute("poster")??""}set poster(e){this.setAttribute("poster",e)}get autoplay(){return this.hasAttribute("autoplay")}set autoplay(e){this.toggleAttribute("autoplay",e)}get loop(){return this.hasAttribute("loop")}set loop(e){this.toggleAttribute("loop",e)}get controls(){return this.hasAttribute("controls")}set controls(e){this.toggleAttribute("controls",e)}get currentTime(){return this.player.currentTime}set currentTime(e){this.player.currentTime=e}get duration(){return this.player.manifest?this.player.duration:NaN}get paused(){return this.player.paused}get ended(){return this.player.ended}get seeking(){return this.player.seeking}get live(){return this.player.live}get playbackRate(){return this.player.playbackRate}set playbackRate(e){this.player.playbackRate=e}get buffered(){let e=this.player.buffered;return{length:e.length,start:t=>e[t][0],end:t=>e[t][1]}}get readyState(){let{player:e}=this;if(!e.manifest)return 0;if(!e.canPlay||e.waiting)return 1;let t=e.duration-e.currentTime;return e.ahead>=Math.min(t,1)?4:e.ahead>.1?3:2}get error(){return this.player.error}get camera(){let{camera:e}=this.player;if(!e)return null;let{clientWidth:t,clientHeight:r}=this.canvas,{viewmat:i,fx:s,fy:o,cx:a,cy:l}=e.view(t,r);return{name:"",width:t,height:r,K:[s,0,a,0,o,l,0,0,1],viewmat:i}}set camera(e){!this.player.camera||!e||(this.player.camera.viewmat=[...e.viewmat],this.player.invalidate())}resetCamera(){this.player.camera?.reset()}get stats(){return this.player.stats}get link(){let{camera:e,currentTime:t}=this.player;return Ce(location.href,{seconds:t,view:e?.state??null})}follow(e){let{seconds:t,view:r}=ge(e);t!==null&&(this.currentTime=t),r&&this.player.camera&&(this.player.camera.state=r),this.player.invalidate()}showPoster(){this.picture.hidden=!this.poster||this.player.canPlay,this.poster&&(this.picture.src=this.poster)}showControls(){this.controlsShown?.remove(),this.controlsShown=this.controls?new me(this,this.shadowRoot,this.player):null}};customElements.get("splat-reel")||customElements.define("splat-reel",fe);var yt=document.querySelector("main[data-splatreel-page]");if(yt){let n=new URLSearchParams(location.search),e=document.createElement("splat-reel");for(let t of["autoplay","loop","controls","share"])e.toggleAttribute(t,n.get(t)!=="0");for(let t of["src","poster"])n.has(t)&&e.setAttribute(t,n.get(t));n.has("src")||e.setAttribute("src","reel/manifest.json"),yt.append(e)}export{$ as Player,fe as SplatReelElement};
