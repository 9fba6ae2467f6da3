var Me=Math.PI,Le=60;function ne(s,t,e,r){let i=new Map,n=[0,0],o=0,a=u=>{i.set(u.pointerId,{x:u.clientX,y:u.clientY,pan:u.button!==0||u.shiftKey}),s.setPointerCapture(u.pointerId),t()?.flick(0,0),n=[0,0]},l=u=>{let f=i.get(u.pointerId),m=t();if(!f||!m)return;let g=u.clientX-f.x,y=u.clientY-f.y;if(i.size===1&&!f.pan){let _=Me/Math.max(Math.min(s.clientWidth,s.clientHeight),1);m.orbit(g*_,y*_);let te=Math.max((u.timeStamp-o)/1e3,.004),re=(Se,Ae)=>.6*Se+.4*Ae;n=[re(n[0],g*_/te),re(n[1],y*_/te)]}else i.size>1&&m.zoom(ie(i)/ie(i,u)),m.pan(g/i.size,y/i.size,e());o=u.timeStamp,[f.x,f.y]=[u.clientX,u.clientY],r()},c=u=>{let f=i.get(u.pointerId);i.delete(u.pointerId),f&&!f.pan&&i.size===0&&u.timeStamp-o<Le&&t()?.flick(...n),r()},h=u=>{u.preventDefault();let f=u.deltaMode===WheelEvent.DOM_DELTA_LINE?16:1;t()?.zoom(Math.exp(Math.min(Math.max(u.deltaY*f,-200),200)*.0015)),r()},d=u=>u.preventDefault();return s.addEventListener("pointerdown",a),s.addEventListener("pointermove",l),s.addEventListener("pointerup",c),s.addEventListener("pointercancel",c),s.addEventListener("wheel",h,{passive:!1}),s.addEventListener("contextmenu",d),()=>{s.removeEventListener("pointerdown",a),s.removeEventListener("pointermove",l),s.removeEventListener("pointerup",c),s.removeEventListener("pointercancel",c),s.removeEventListener("wheel",h),s.removeEventListener("contextmenu",d)}}function ie(s,t){let e=[...s].map(([n,o])=>t&&n===t.pointerId?{x:t.clientX,y:t.clientY}:o),r=e.reduce((n,o)=>n+o.x,0)/e.length,i=e.reduce((n,o)=>n+o.y,0)/e.length;return Math.max(e.reduce((n,o)=>n+Math.hypot(o.x-r,o.y-i),0)/e.length,1)}var x=(s,t)=>[s[0]+t[0],s[1]+t[1],s[2]+t[2]],E=(s,t)=>[s[0]-t[0],s[1]-t[1],s[2]-t[2]],b=(s,t)=>[s[0]*t,s[1]*t,s[2]*t],R=(s,t)=>s[0]*t[0]+s[1]*t[1]+s[2]*t[2],k=s=>Math.sqrt(R(s,s));function U(s,t){return[s[1]*t[2]-s[2]*t[1],s[2]*t[0]-s[0]*t[2],s[0]*t[1]-s[1]*t[0]]}function P(s){let t=k(s);return t>1e-12?b(s,1/t):[0,0,1]}function Y(s,t,e){let r=Math.cos(e),i=Math.sin(e),n=R(t,s)*(1-r);return x(x(b(s,r),b(U(t,s),i)),b(t,n))}function se(s,t,e,r){let i=n=>[...n,-R(n,s)];return[...i(t),...i(e),...i(r),0,0,0,1]}function S(s){let t=e=>-(s[e]*s[3]+s[4+e]*s[7]+s[8+e]*s[11]);return[t(0),t(1),t(2)]}var Fe=6,oe=.1,V=class{up;home;extent;near;homePivot;pivot=[0,0,0];eye=[0,0,0];right=[1,0,0];down=[0,1,0];forward=[0,0,1];spin=[0,0];constructor(t){let[e,r]=t.bounds,i=b(x(e,r),.5);this.up=P(t.up),this.home=t.camera,this.near=.2*t.near,this.extent=Math.max(k(E(r,e)),1e-6);let n=this.home.viewmat,o=S(n),a=[n[8],n[9],n[10]],l=R(E(i,o),a);this.homePivot=x(o,b(a,l>.05*this.extent?l:.5*this.extent)),this.reset()}reset(){this.moveTo(this.home.viewmat,this.homePivot)}get viewmat(){return se(this.eye,this.right,this.down,this.forward)}set viewmat(t){let e=k(E(this.pivot,this.eye));this.moveTo(t,x(S(t),b([t[8],t[9],t[10]],e)))}orbit(t,e){let r=Math.acos(Math.min(Math.max(R(this.forward,this.up),-1),1)),i=Math.min(Math.max(-e,Math.min(r-Math.PI+oe,0)),Math.max(r-oe,0)),n=a=>Y(Y(a,this.right,i),this.up,-t),o=n(E(this.eye,this.pivot));[this.right,this.down,this.forward]=[n(this.right),n(this.down),n(this.forward)],this.forward=P(this.forward),this.right=P(U(this.down,this.forward)),this.down=U(this.forward,this.right),this.eye=x(this.pivot,o)}pan(t,e,r){let i=k(E(this.pivot,this.eye))/r,n=x(b(this.right,-t*i),b(this.down,-e*i));this.eye=x(this.eye,n),this.pivot=x(this.pivot,n)}zoom(t){let e=E(this.eye,this.pivot),r=k(e),i=Math.min(Math.max(r*t,.01*this.extent),Math.max(5*this.extent,r));this.eye=x(this.pivot,b(e,i/r))}flick(t,e){this.spin=[t,e]}step(t){let[e,r]=this.spin;if(Math.hypot(e,r)<.02)return!1;this.orbit(e*t,r*t);let i=Math.exp(-Fe*t);return this.spin=[e*i,r*i],!0}view(t,e){let{K:r,width:i,height:n}=this.home,o=Math.min(t/i,e/n),a=Math.max(t/i,e/n),l=Math.min(a,1.4*o);return{viewmat:this.viewmat,fx:r[0]*l,fy:r[4]*l,cx:t/2+(r[2]-i/2)*l,cy:e/2+(r[5]-n/2)*l,width:t,height:e,near:this.near}}moveTo(t,e){this.eye=S(t),[this.right,this.down,this.forward]=[[t[0],t[1],t[2]],[t[4],t[5],t[6]],[t[8],t[9],t[10]]],this.pivot=e,this.spin=[0,0]}};var p=class extends Error{name="ReelError"};function z(s){return s instanceof Error?s.message:String(s)}async function ue(s){let t;try{t=await fetch(s,{cache:"no-cache"})}catch(i){throw new p(`Cannot reach ${s} (${z(i)}). Check the address, the network and the host's CORS headers.`)}if(!t.ok)throw new p(`${s} answered ${t.status} ${t.statusText}`.trim()+".");let e=await t.text(),r;try{r=JSON.parse(e)}catch{throw new p(`${s} is not a reel's manifest: it is not JSON.`)}return De(r,new URL(s,location.href).href)}function De(s,t){let e=K(s,"the manifest");if(e.format!=="splatreel")throw new p(`${t} is not a reel: its format is ${JSON.stringify(e.format)}.`);if(e.version!==1)throw new p(`${t} is a reel of version ${JSON.stringify(e.version)}; this player knows version 1.`);let r=A(e.bounds,"bounds").map(n=>N(n,3,"bounds"));if(r.length!==2)throw new p(`${t}: bounds needs two corners.`);let i=A(e.groups,"groups").map((n,o)=>ae(n,o));if(i.length===0)throw new p(`${t} holds no group yet.`);return{url:t,live:e.live===!0,fps:M(e.fps,"fps"),frames:M(e.frames,"frames"),overlap:w(e.overlap,"overlap"),shDegree:w(e.sh_degree,"sh_degree"),near:e.near===void 0?.01:M(e.near,"near"),bounds:r,up:N(e.up,3,"up"),camera:le(e.camera),cameras:A(e.cameras??[],"cameras").map(le),layers:A(e.layers,"layers").map((n,o)=>ae(n,o)),groups:i}}function ae(s,t){let e=K(s,"a file");if(typeof e.uri!="string")throw new p("The manifest names a file without a uri.");return{uri:e.uri,bytes:w(e.bytes,"bytes"),firstFrame:w(e.first_frame??0,"first_frame"),frames:w(e.frames??0,"frames"),points:w(e.points,"points"),group:w(e.group??t,"group")}}function le(s){let t=K(s,"a camera");return{name:String(t.name??""),width:M(t.width,"camera width"),height:M(t.height,"camera height"),K:N(t.K,9,"camera K"),viewmat:N(t.viewmat,16,"camera viewmat")}}function K(s,t){if(typeof s!="object"||s===null||Array.isArray(s))throw new p(`The manifest is damaged: ${t} is not an object.`);return s}function A(s,t){if(!Array.isArray(s))throw new p(`The manifest is damaged: ${t} is not a list.`);return s}function w(s,t){if(typeof s!="number"||!Number.isFinite(s))throw new p(`The manifest is damaged: ${t} is ${JSON.stringify(s)}, not a number.`);return s}function M(s,t){let e=w(s,t);if(e<=0)throw new p(`The manifest is damaged: ${t} is ${e}.`);return e}function N(s,t,e){let r=A(s,e).flat();if(r.length!==t)throw new p(`The manifest is damaged: ${e} has ${r.length} numbers, not ${t}.`);return r.map(i=>w(i,e))}var ce=`#version 300 es
void main() {
  // One triangle that covers the viewport.
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`,he=`#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2DArray uPoints;
uniform highp sampler2D uCodebook;
uniform highp usampler2D uFlags;
uniform highp usampler2DArray uDx;
uniform highp usampler2DArray uDq;
uniform int uFirstRow;
uniform int uCount;
uniform int uShDegree;
uniform bool uMoving;
uniform ivec2 uFrames;
uniform float uBetween;
uniform vec3 uDxMin, uDxStep;
uniform vec4 uDqMin, uDqStep;
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

/** The view-dependent part of a colour: coefficients 1..15 in the 3DGS order, one texel each. */
vec3 viewDependent(int index, vec3 d) {
  ivec2 at = ivec2((index % 64) * 15, index / 64);
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
  if (at.y * 1024 + at.x >= uCount) return;
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
  // Faded in optical depth: two coinciding points of weights w and 1 - w absorb what one does.
  float opacity = 1.0 - pow(1.0 - min(opacityAndRed.x, 0.9999), weight);
  if (opacity < 1.0 / 255.0) return;

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

  // Axes of the ellipse where alpha falls to 1/255.
  float middle = 0.5 * (xx + yy);
  float spread = length(vec2(0.5 * (xx - yy), xy));
  float major = middle + spread;
  float minor = max(middle - spread, 0.0);
  vec2 direction = abs(xy) < 1e-6 * major ? (xx >= yy ? vec2(1, 0) : vec2(0, 1)) : normalize(vec2(xy, major - xx));
  float extent = sqrt(2.0 * log(255.0 * opacity));
  vec2 axis = direction * sqrt(major) * extent;
  vec2 other = vec2(-direction.y, direction.x) * sqrt(minor) * extent;

  vec2 center = focal * camera.xy + uLens.zw;
  vec2 reach = abs(axis) + abs(other);
  if (any(lessThan(center + reach, vec2(0.0))) || any(greaterThan(center - reach, uSize))) return;
  color *= 0.28209479177387814;
  if (uShDegree > 0) color += viewDependent(int(p0.w), normalize(mean - uEye));
  color = max(color + 0.5, 0.0);
  outShape = uvec4(floatBitsToUint(center), packHalf2x16(axis), packHalf2x16(other));
  outColor = uvec4(packHalf2x16(color.rg), packHalf2x16(vec2(color.b, opacity)), floatBitsToUint(extent), 0u);
}`,de=`#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D uShape;
uniform highp usampler2D uColor;
uniform vec2 uSize;
layout(location = 0) in uint aPoint;
out vec2 vAt;
flat out vec4 vColor;
void main() {
  ivec2 at = ivec2(int(aPoint) % 1024, int(aPoint) / 1024);
  uvec4 color = texelFetch(uColor, at, 0);
  float extent = uintBitsToFloat(color.z);
  if (extent <= 0.0) {
    gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
    return;
  }
  uvec4 shape = texelFetch(uShape, at, 0);
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  vec2 pixel = uintBitsToFloat(shape.xy) + corner.x * unpackHalf2x16(shape.z) + corner.y * unpackHalf2x16(shape.w);
  gl_Position = vec4(pixel / uSize * vec2(2.0, -2.0) + vec2(-1.0, 1.0), 0.0, 1.0);
  vAt = corner * extent;
  vColor = vec4(unpackHalf2x16(color.x), unpackHalf2x16(color.y));
}`,pe=`#version 300 es
precision highp float;
in vec2 vAt;
flat in vec4 vColor;
out vec4 outColor;
void main() {
  float alpha = min(0.999, vColor.a * exp(-0.5 * dot(vAt, vAt)));
  if (alpha < 1.0 / 255.0) discard;
  outColor = vec4(vColor.rgb * alpha, alpha);
}`;function T(s){return Math.ceil(s/1024)}var L=class{constructor(t,e,r,i){this.gl=t;this.firstRow=e;this.count=r.count,this.shDegree=r.shDegree,r.count!==0&&(this.points=this.uploadPoints(r),r.shDegree>0&&(this.codebook=this.uploadCodebook(r.codebook,3*((r.shDegree+1)**2-1))),i&&(this.range=i,this.dx=this.uploadFrames(i.dx,i.frames,t.RGBA16UI,t.UNSIGNED_SHORT),this.dq=this.uploadFrames(i.dq,i.frames,t.RGBA8UI,t.UNSIGNED_BYTE)))}gl;firstRow;count;shDegree;points=null;codebook=null;range=null;flags=null;dx=null;dq=null;setFlags(t){if(this.count===0)return;let{gl:e}=this,r=T(this.count),i=new Uint8Array(r*1024);i.set(t),this.flags===null&&(this.flags=this.create(e.TEXTURE_2D),e.texStorage2D(e.TEXTURE_2D,1,e.R8UI,1024,r)),e.bindTexture(e.TEXTURE_2D,this.flags),e.pixelStorei(e.UNPACK_ALIGNMENT,1),e.texSubImage2D(e.TEXTURE_2D,0,0,0,1024,r,e.RED_INTEGER,e.UNSIGNED_BYTE,i)}delete(){for(let t of[this.points,this.codebook,this.flags,this.dx,this.dq])this.gl.deleteTexture(t)}uploadPoints(t){let{gl:e}=this,r=T(t.count),i=r*1024*4,n=new Uint32Array(3*i),o=new Float32Array(n.buffer),{means:a,quats:l,scales:c,opacities:h,shBase:d,shRest:u}=t;for(let m=0;m<t.count;m++){let g=4*m;for(let y=0;y<3;y++)o[g+y]=a[3*m+y];n[g+3]=u[m],g+=i;for(let y=0;y<3;y++)o[g+y]=c[3*m+y];n[g+3]=O(h[m],d[3*m]),g+=i,n[g]=O(l[4*m],l[4*m+1]),n[g+1]=O(l[4*m+2],l[4*m+3]),n[g+2]=O(d[3*m+1],d[3*m+2])}let f=this.create(e.TEXTURE_2D_ARRAY);return e.texStorage3D(e.TEXTURE_2D_ARRAY,1,e.RGBA32UI,1024,r,3),e.texSubImage3D(e.TEXTURE_2D_ARRAY,0,0,0,0,1024,r,3,e.RGBA_INTEGER,e.UNSIGNED_INT,n),f}uploadCodebook(t,e){let{gl:r}=this,i=t.length/e,n=Math.ceil(i/64),o=960,a=new Float32Array(n*o*4);for(let c=0;c<i;c++)for(let h=0;h<e;h++)a[4*(c*15+Math.floor(h/3))+h%3]=t[c*e+h];let l=this.create(r.TEXTURE_2D);return r.texStorage2D(r.TEXTURE_2D,1,r.RGBA16F,o,n),r.texSubImage2D(r.TEXTURE_2D,0,0,0,o,n,r.RGBA,r.FLOAT,a),l}uploadFrames(t,e,r,i){let{gl:n,count:o}=this,a=this.create(n.TEXTURE_2D_ARRAY);n.texStorage3D(n.TEXTURE_2D_ARRAY,1,r,1024,T(o),e),n.pixelStorei(n.UNPACK_ALIGNMENT,1);let l=Math.floor(o/1024),c=o-l*1024,h=(d,u,f,m)=>{let g=4*(d*o+u*1024),y=t.subarray(g,g+4*f*m);n.texSubImage3D(n.TEXTURE_2D_ARRAY,0,0,u,d,f,m,1,n.RGBA_INTEGER,i,y)};for(let d=0;d<e;d++)l>0&&h(d,0,1024,l),c>0&&h(d,l,c,1);return a}create(t){let{gl:e}=this,r=e.createTexture();e.bindTexture(t,r);for(let i of[e.TEXTURE_MIN_FILTER,e.TEXTURE_MAG_FILTER])e.texParameteri(t,i,e.NEAREST);for(let i of[e.TEXTURE_WRAP_S,e.TEXTURE_WRAP_T])e.texParameteri(t,i,e.CLAMP_TO_EDGE);return r}},ge=new Float32Array(1),_e=new Uint32Array(ge.buffer);function ve(s){ge[0]=s;let t=_e[0],e=t>>>16&32768,r=t&2147483647;return r>=1199570944?e|31743:r<947912704?e|Math.round(Math.abs(s)*2**24):Math.min((e|r-939524096+4096>>>13)&65535,e|31743)}function O(s,t){return(ve(s)|ve(t)<<16)>>>0}function Ue(s,t){let e=0,r=s.length-1;for(;e<r;){let i=e+r+1>>1;s[i].firstFrame<=t?e=i:r=i-1}return e}function ye(s,t,e,r){let i=r*e;return Z(s,t,i,Ue(s,i))}function Z(s,t,e,r){let i=e-s[r].firstFrame,n=t>0?Math.min(Math.max(i/t,0),1):1,o=n<1&&r>0;return{current:{group:r,frame:C(s[r],e)},previous:o?{group:r-1,frame:C(s[r-1],e)}:null,weight:o?n:1}}function C(s,t){return Math.min(Math.max(t-s.firstFrame,0),Math.max(s.frames-1,0))}var Pe=1,Ve=2;function be(s,t,e){let r=new Uint8Array(s);for(let n=0;n<Math.min(s,t.length);n++)r[n]=t[n]*Pe;let i=e??t;for(let n=0;n<Math.min(s,i.length);n++)r[n]|=i[n]*Ve;return r}function xe(s){return[0,s,1-s,1]}var I=4,W=class{constructor(t,e,r){this.canvas=t;let i=t.getContext("webgl2",{alpha:!1,antialias:!1,depth:!1,powerPreference:"high-performance"});if(!i)throw new p("This browser or device offers no WebGL 2, which the player draws with.");this.gl=i,this.project=new G(i,ce,he),this.splat=new G(i,de,pe),this.slotRows=T(r),this.layerRows=[0];for(let a of e)this.layerRows.push(this.layerRows.at(-1)+T(a));let n=Math.max(this.layerRows.at(-1)+I*this.slotRows,1),o=i.getParameter(i.MAX_TEXTURE_SIZE);if(n>o)throw new p(`The reel has more points than this device draws (${n*1024} of ${o*1024}).`);this.shape=this.integerTexture(n),this.color=this.integerTexture(n),this.target=i.createFramebuffer(),i.bindFramebuffer(i.FRAMEBUFFER,this.target),i.framebufferTexture2D(i.FRAMEBUFFER,i.COLOR_ATTACHMENT0,i.TEXTURE_2D,this.shape,0),i.framebufferTexture2D(i.FRAMEBUFFER,i.COLOR_ATTACHMENT1,i.TEXTURE_2D,this.color,0),i.drawBuffers([i.COLOR_ATTACHMENT0,i.COLOR_ATTACHMENT1]),this.empty=i.createVertexArray(),this.quads=i.createVertexArray(),this.order=i.createBuffer(),i.bindVertexArray(this.quads),i.bindBuffer(i.ARRAY_BUFFER,this.order),i.enableVertexAttribArray(0),i.vertexAttribIPointer(0,1,i.UNSIGNED_INT,0,0),i.vertexAttribDivisor(0,1)}canvas;gl;project;splat;target;shape;color;quads;empty;order;layerRows;slotRows;slots=Array(I).fill(null);layers=[];groups=new Map;flagsKey="";drawn=0;addLayer(t,e){return this.layers[t]=new L(this.gl,this.layerRows[t],e.points,null),this.flagsKey="",this.layerRows[t]*1024}addGroup(t,e){let r=this.slots.indexOf(null);if(r<0)throw new Error("No free slot: drop a group first.");this.slots[r]=t;let i=this.layerRows.at(-1)+r*this.slotRows,n=new L(this.gl,i,e.points,e.offsets);return this.groups.set(t,{textures:n,alive:e.alive}),i*1024}dropGroup(t){this.groups.get(t)?.textures.delete(),this.groups.delete(t);let e=this.slots.indexOf(t);e>=0&&(this.slots[e]=null)}holds(t){return[t.current,t.previous].every(e=>e===null||this.groups.has(e.group))}setOrder(t,e){let{gl:r}=this;r.bindBuffer(r.ARRAY_BUFFER,this.order),r.bufferData(r.ARRAY_BUFFER,t,r.DYNAMIC_DRAW,0,e),this.drawn=e}draw(t,e,r){let{gl:i,canvas:n}=this;(n.width!==r.width||n.height!==r.height)&&([n.width,n.height]=[r.width,r.height]),this.updateFlags(t),this.projectPoints(t,e,r),i.bindFramebuffer(i.FRAMEBUFFER,null),i.viewport(0,0,r.width,r.height),i.clearColor(0,0,0,1),i.clear(i.COLOR_BUFFER_BIT),this.splat.use(),this.splat.texture("uShape",0,i.TEXTURE_2D,this.shape),this.splat.texture("uColor",1,i.TEXTURE_2D,this.color),i.uniform2f(this.splat.at("uSize"),r.width,r.height),i.bindVertexArray(this.quads),i.enable(i.BLEND),i.blendFunc(i.ONE,i.ONE_MINUS_SRC_ALPHA),i.drawArraysInstanced(i.TRIANGLE_STRIP,0,4,this.drawn),i.disable(i.BLEND)}readPixels(){let{gl:t,canvas:e}=this,{width:r,height:i}=e,n=new Uint8Array(4*r*i);t.readPixels(0,0,r,i,t.RGBA,t.UNSIGNED_BYTE,n);let o=new Uint8Array(n.length);for(let a=0;a<i;a++)o.set(n.subarray(4*r*a,4*r*(a+1)),4*r*(i-1-a));return o}destroy(){let{gl:t}=this;for(let e of[...this.layers,...[...this.groups.values()].map(r=>r.textures)])e?.delete();for(let e of[this.shape,this.color])t.deleteTexture(e);for(let e of[this.quads,this.empty])t.deleteVertexArray(e);t.deleteFramebuffer(this.target),t.deleteBuffer(this.order),this.project.delete(),this.splat.delete()}updateFlags(t){let e=`${t.layers} ${t.current?.group} ${t.previous?.group}`;if(e===this.flagsKey)return;this.flagsKey=e;let r=this.layers.slice(0,t.layers),i=r.reduce((l,c)=>l+c.count,0),n=t.current?this.groups.get(t.current.group).alive:new Uint8Array(i).fill(1),o=be(i,n,t.previous?this.groups.get(t.previous.group).alive:null),a=0;for(let l of r)l.setFlags(o.subarray(a,a+l.count)),a+=l.count}projectPoints(t,e,r){let{gl:i,project:n}=this;i.bindFramebuffer(i.FRAMEBUFFER,this.target),i.bindVertexArray(this.empty),n.use(),ze(i,n,r),i.uniform1i(n.at("uMoving"),0),i.uniform4fv(n.at("uWeights"),xe(e));for(let o of this.layers.slice(0,t.layers))this.projectFile(o);i.uniform1i(n.at("uMoving"),1),this.projectGroup(t.current,e),this.projectGroup(t.previous,1-e)}projectGroup(t,e){let r=t&&this.groups.get(t.group).textures;if(!t||!r||!r.range)return;let{gl:i,project:n}=this,{frames:o,dxMin:a,dxStep:l,dqMin:c,dqStep:h}=r.range,d=Math.min(Math.floor(t.frame),o-1);i.uniform2i(n.at("uFrames"),d,Math.min(d+1,o-1)),i.uniform1f(n.at("uBetween"),t.frame-d),i.uniform3fv(n.at("uDxMin"),a),i.uniform3fv(n.at("uDxStep"),l),i.uniform4fv(n.at("uDqMin"),c),i.uniform4fv(n.at("uDqStep"),h),i.uniform4f(n.at("uWeights"),e,0,0,0),this.projectFile(r)}projectFile(t){if(t.count===0)return;let{gl:e,project:r}=this;r.texture("uPoints",0,e.TEXTURE_2D_ARRAY,t.points),r.texture("uCodebook",1,e.TEXTURE_2D,t.codebook),r.texture("uFlags",2,e.TEXTURE_2D,t.flags),r.texture("uDx",3,e.TEXTURE_2D_ARRAY,t.dx),r.texture("uDq",4,e.TEXTURE_2D_ARRAY,t.dq),e.uniform1i(r.at("uFirstRow"),t.firstRow),e.uniform1i(r.at("uCount"),t.count),e.uniform1i(r.at("uShDegree"),t.shDegree),e.viewport(0,t.firstRow,1024,T(t.count)),e.drawArrays(e.TRIANGLES,0,3)}integerTexture(t){let{gl:e}=this,r=e.createTexture();return e.bindTexture(e.TEXTURE_2D,r),e.texStorage2D(e.TEXTURE_2D,1,e.RGBA32UI,1024,t),e.texParameteri(e.TEXTURE_2D,e.TEXTURE_MIN_FILTER,e.NEAREST),e.texParameteri(e.TEXTURE_2D,e.TEXTURE_MAG_FILTER,e.NEAREST),r}};function ze(s,t,e){let{viewmat:r,fx:i,fy:n,cx:o,cy:a,width:l,height:c}=e,h=.15*l/i,d=.15*c/n;s.uniformMatrix4fv(t.at("uView"),!0,r),s.uniform3fv(t.at("uEye"),S(r)),s.uniform4f(t.at("uLens"),i,n,o,a),s.uniform4f(t.at("uRange"),-o/i-h,(l-o)/i+h,-a/n-d,(c-a)/n+d),s.uniform2f(t.at("uSize"),l,c),s.uniform1f(t.at("uNear"),e.near)}var G=class{constructor(t,e,r){this.gl=t;this.program=t.createProgram();let i=[we(t,t.VERTEX_SHADER,e),we(t,t.FRAGMENT_SHADER,r)];for(let n of i)t.attachShader(this.program,n);t.linkProgram(this.program);for(let n of i)t.deleteShader(n);if(!t.getProgramParameter(this.program,t.LINK_STATUS)&&!t.isContextLost())throw new p(`This device's graphics driver refuses the player's shaders: ${t.getProgramInfoLog(this.program)}`)}gl;program;locations=new Map;use(){this.gl.useProgram(this.program)}at(t){let e=this.locations.get(t);return e===void 0&&this.locations.set(t,e=this.gl.getUniformLocation(this.program,t)),e}texture(t,e,r,i){let{gl:n}=this;n.activeTexture(n.TEXTURE0+e),n.bindTexture(r,i),n.uniform1i(this.at(t),e)}delete(){this.gl.deleteProgram(this.program)}};function we(s,t,e){let r=s.createShader(t);if(s.shaderSource(r,e),s.compileShader(r),!s.getShaderParameter(r,s.COMPILE_STATUS)&&!s.isContextLost())throw new p(`This device's graphics driver refuses the player's shaders: ${s.getShaderInfoLog(r)}`);return r}function B(s){return new Worker(new URL(s,import.meta.url))}var q=class{worker=B("sort-worker.js");waiting=null;spare=null;constructor(t){this.worker.onmessage=({data:e})=>{let r=this.waiting;this.waiting=null,r?.(e)},this.worker.onerror=e=>t(`Sorting failed (${e.message}).`)}get busy(){return this.waiting!==null}addLayer(t,e,r){let{means:i}=r.points;this.post({type:"layer",index:t,layer:{base:e,means:i}},[i.buffer])}addGroup(t,e,r){let{means:i}=r.points,{dx:n,dxMin:o,dxStep:a,frames:l}=r.offsets??{dx:new Uint16Array,dxMin:[0,0,0],dxStep:[0,0,0],frames:1},c={base:e,means:i,frames:l,dx:n,dxMin:o,dxStep:a,alive:r.alive};this.post({type:"group",index:t,group:c},[i.buffer,n.buffer])}dropGroup(t){this.post({type:"drop",index:t})}sort(t,e){let[,,,,,,,,r,i,n,o]=e.viewmat,a=this.spare;return this.spare=null,new Promise(l=>{this.waiting=l,this.post({type:"sort",scene:t,axis:[r,i,n,o],near:e.near,buffer:a},a?[a.buffer]:[])})}recycle(t){this.spare=t}destroy(){this.worker.terminate()}post(t,e=[]){this.worker.postMessage(t,e)}};var Ne=2,Oe=1,$=class{constructor(t,e,r){this.manifest=t;this.slots=e;this.events=r;this.workers=Array.from({length:Ne},()=>B("decode-worker.js")),this.idle=[...this.workers]}manifest;slots;events;workers;idle;loading=new Map;layers=new Set;groups=new Set;current=0;previous=null;inUse=[];failures=new Map;nextId=0;get layersReady(){let t=0;for(;this.layers.has(t);)t++;return t}layersOf(t){return this.manifest.layers.filter(e=>e.group<=t).length}has(t){return this.groups.has(t)&&this.layersReady>=this.layersOf(t)}get held(){return[...this.groups].sort((t,e)=>t-e)}want(t,e,r){this.current=t,this.previous=e,this.inUse=r,this.fill()}retry(){this.failures.clear(),this.fill()}destroy(){for(let t of this.workers)t.terminate()}fill(){for(let t of this.queue()){let e=`${t.kind} ${t.index}`,r=this.failures.get(e);if(r){if(this.isNeededNow(t)){this.events.failed(r);return}continue}if(this.idle.length===0)return;this.loading.has(e)||(t.kind==="layer"?this.layers:this.groups).has(t.index)||t.kind==="group"&&!this.makeRoom()||this.load(t,e)}}isNeededNow({kind:t,index:e}){return t==="layer"?this.manifest.layers[e].group<=this.current:e===this.current||e===this.previous}queue(){let{current:t,previous:e}=this,r=this.manifest.groups.length-1,i=(o,a)=>this.manifest.layers.flatMap((l,c)=>l.group>=o&&l.group<=a?[{kind:"layer",index:c}]:[]),n=i(0,t);n.push({kind:"group",index:t}),e!==null&&n.push({kind:"group",index:e});for(let o=1;o<=Oe;o++){let a=t+o<=r?t+o:t+o-r-1;a!==t&&n.push(...i(t+1,a),{kind:"group",index:a})}return n}makeRoom(){let t=[...this.loading.values()].filter(i=>i.kind==="group").length;if(this.groups.size+t<this.slots)return!0;let e=new Set([...this.inUse,...this.queue().filter(i=>i.kind==="group").map(i=>i.index)]),r=this.held.find(i=>!e.has(i));return r===void 0?!1:(this.groups.delete(r),this.events.dropped(r),!0)}load(t,e){let r=this.idle.pop();this.loading.set(e,t);let i=(t.kind==="layer"?this.manifest.layers:this.manifest.groups)[t.index],n=a=>{this.loading.delete(e),this.idle.push(r),a(),this.fill()};r.onmessage=({data:a})=>n(()=>{a.file?this.deliver(t,a.file):this.failures.set(e,new p(a.error??"A file could not be decoded."))}),r.onerror=a=>n(()=>{this.failures.set(e,new p(`${i.uri} cannot be decoded (${a.message}).`))});let o={id:this.nextId++,url:new URL(i.uri,this.manifest.url).href,bytes:i.bytes};r.postMessage(o)}deliver({kind:t,index:e},r){t==="layer"?(this.layers.add(e),this.events.layer(e,r)):(this.groups.add(e),this.events.group(e,r))}};var Ce=.25,F=class extends EventTarget{constructor(e){super();this.canvas=e;e.addEventListener("webglcontextlost",i=>{i.preventDefault(),this.fail(new Error("The graphics device was lost. Try again in a moment."))});let r=i=>{this.tickRequest=requestAnimationFrame(r),this.tick(i)};this.tickRequest=requestAnimationFrame(r)}canvas;camera=null;manifest=null;error=null;loop=!1;playbackRate=1;sortMilliseconds=0;renderer=null;stream=null;sorter=null;source="";seconds=0;playing=!1;stalled=!0;seeking=!1;ready=!1;scene=null;drawnSeconds=0;dirty=!1;sortAgain=!1;held=!1;lastTick=0;tickRequest=0;generation=0;async load(e){this.unload(),this.source=e;let r=++this.generation;try{let i=await ue(e);if(r!==this.generation)return;this.open(i)}catch(i){r===this.generation&&this.fail(i)}}retry(){this.error=null;let e=this.canvas.getContext("webgl2")?.isContextLost()===!0;this.stream&&!e?this.stream.retry():this.load(this.source)}destroy(){this.generation++,cancelAnimationFrame(this.tickRequest),this.unload()}get duration(){return this.manifest?this.manifest.frames/this.manifest.fps:0}get currentTime(){return this.seconds}set currentTime(e){this.seconds=Math.min(Math.max(e,0),this.duration),this.seeking=!0,this.emit("seeking"),this.emit("timeupdate"),this.update()}get paused(){return!this.playing}get ended(){return this.duration>0&&this.seconds>=this.duration}get waiting(){return this.stalled}get canPlay(){return this.ready}get buffered(){let{manifest:e,stream:r}=this;if(!e||!r)return[];let i=[];for(let n of r.held.filter(o=>r.has(o))){let o=e.groups[n].firstFrame/e.fps,a=(e.groups[n+1]?.firstFrame??e.frames)/e.fps,l=i.at(-1);l&&Math.abs(l[1]-o)<1e-6?l[1]=a:i.push([o,a])}return i}play(){this.playing||(this.ended&&(this.currentTime=0),this.playing=!0,this.emit("play"))}pause(){this.playing&&(this.playing=!1,this.emit("pause"))}invalidate(){this.dirty=!0,this.sortAgain=!0}whenReady(){return this.until("canplay",()=>this.ready)}async renderAt(e,r,i,n){await this.whenReady(),this.pause(),this.currentTime=e,await this.until("seeked",()=>!this.seeking);let{sorter:o,renderer:a}=this;if(!o||!a)throw new Error("The reel was closed.");this.held=!0;try{for(;o.busy;)await new Promise(f=>setTimeout(f,1));let l=this.momentNow(),c=this.sceneOf(l),{K:h,viewmat:d}=r,u={viewmat:d,fx:h[0],fy:h[4],cx:h[2],cy:h[5],width:i,height:n,near:this.manifest.near};return await this.sort(c,u),a.draw(c,l.weight,u),{width:i,height:n,data:a.readPixels()}}finally{this.held=!1,this.invalidate()}}open(e){this.manifest=e,this.camera=new V(e),this.renderer=new W(this.canvas,e.layers.map(r=>r.points),Math.max(...e.groups.map(r=>r.points))),this.sorter=new q(r=>this.fail(new Error(r))),this.stream=new $(e,I,{layer:(r,i)=>{this.sorter.addLayer(r,this.renderer.addLayer(r,i),i),this.arrived()},group:(r,i)=>{this.sorter.addGroup(r,this.renderer.addGroup(r,i),i),this.arrived()},dropped:r=>{this.renderer.dropGroup(r),this.sorter.dropGroup(r),this.emit("progress")},failed:r=>this.fail(r)}),this.seconds=Math.min(this.seconds,this.duration),this.emit("loadedmetadata"),this.update()}unload(){this.stream?.destroy(),this.sorter?.destroy(),this.renderer?.destroy(),[this.stream,this.sorter,this.renderer,this.manifest,this.camera,this.scene]=[null,null,null,null,null,null],[this.error,this.ready,this.stalled]=[null,!1,!0]}arrived(){this.emit("progress"),this.update(),this.invalidate()}fail(e){this.error||(this.error=e instanceof Error?e:new Error(z(e)),this.emit("error"))}emit(e){this.dispatchEvent(new Event(e))}until(e,r){return new Promise((i,n)=>{let o=()=>{if(this.error)n(this.error);else if(r())i();else return;this.removeEventListener(e,o),this.removeEventListener("error",o)};this.addEventListener(e,o),this.addEventListener("error",o),o()})}momentNow(){let{groups:e,overlap:r,fps:i,frames:n}=this.manifest;return ye(e,r,i,Math.min(this.seconds,Math.max(n-1,0)/i))}sceneOf({current:e,previous:r}){return{layers:this.stream.layersOf(e.group),current:e,previous:r}}update(){let{stream:e}=this;if(!e)return;let{current:r,previous:i}=this.momentNow(),n=[this.scene?.current?.group,this.scene?.previous?.group].filter(a=>a!==void 0);e.want(r.group,i?.group??null,n);let o=e.has(r.group)&&(i===null||e.has(i.group));o===this.stalled&&(this.stalled=!o,this.emit(o?"playing":"waiting"))}tick(e){let r=Math.min((e-this.lastTick)/1e3,Ce);if(this.lastTick=e,!this.stream||!this.camera||this.held)return;this.advance(r),this.camera.step(r)&&this.invalidate();let i=this.viewNow();i&&(this.sorter.busy||this.startSort(i),this.dirty&&this.scene&&this.drawNow(i))}advance(e){!this.playing||this.stalled||this.seeking||(this.seconds+=e*this.playbackRate,this.seconds>=this.duration&&(this.loop?this.seconds%=this.duration:this.seconds=this.duration),this.emit("timeupdate"),this.update(),this.invalidate(),this.ended&&!this.loop&&(this.pause(),this.emit("ended")))}viewNow(){let e=Math.min(globalThis.devicePixelRatio||1,2),r=Math.round(this.canvas.clientWidth*e),i=Math.round(this.canvas.clientHeight*e);return r>0&&i>0?this.camera.view(r,i):null}startSort(e){if(!this.sortAgain&&!this.seeking)return;let r=this.stream.layersReady,i=this.stalled?this.scene?.current?null:{layers:r,current:null,previous:null}:this.sceneOf(this.momentNow());!i||i.current===null&&r===0||(this.sortAgain=!1,this.sort(i,e))}async sort(e,r){let{sorter:i,renderer:n}=this,o=await i.sort(e,r);n!==this.renderer||!n.holds(e)||(this.sortMilliseconds=o.milliseconds,n.setOrder(o.order,o.count),i.recycle(o.order),this.scene=e,this.dirty=!0,this.settle(e))}settle(e){this.stalled||e.current===null||(this.seeking&&e.current.group===this.momentNow().current.group&&(this.seeking=!1,this.emit("seeked")),this.ready||(this.ready=!0,this.emit("canplay")))}drawNow(e){let r=this.scene,{groups:i,overlap:n,fps:o}=this.manifest;if(this.dirty=!1,r.current===null){this.renderer.draw(r,1,e);return}let a=Math.min(this.seconds,(this.manifest.frames-1)/o),{firstFrame:l,frames:c}=i[r.current.group],h=a*o>=l&&a*o<=l+c-1,d=this.momentNow().current.group===r.current.group;(h||d)&&!this.seeking&&!this.stalled&&(this.drawnSeconds=a);let u=Z(i,n,this.drawnSeconds*o,r.current.group),f=r.previous&&{group:r.previous.group,frame:C(i[r.previous.group],this.drawnSeconds*o)};this.renderer.draw({...r,current:u.current,previous:f},f?u.weight:1,e)}};var Ee=`:host {
  position: relative;
  display: block;
  overflow: hidden;
  background: #000;
  color: #f2f2f3;
  font: 500 13px/1.4 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  -webkit-tap-highlight-color: transparent;
  container-type: inline-size;
}
* { box-sizing: border-box; }
[hidden] { display: none !important; }
canvas { display: block; width: 100%; height: 100%; touch-action: none; cursor: grab; outline: none; }
canvas:active { cursor: grabbing; }
:host(.idle) canvas { cursor: none; }

.bar {
  position: absolute;
  inset: auto 0 0 0;
  padding: 56px 16px max(12px, env(safe-area-inset-bottom));
  background: linear-gradient(transparent, rgb(0 0 0 / 0.72));
  pointer-events: none;
  transition: opacity 0.25s ease, transform 0.25s ease;
}
.bar > * { pointer-events: auto; }
:host(.idle) .bar { opacity: 0; transform: translateY(6px); }
.row { display: flex; align-items: center; gap: 4px; margin-top: 2px; }
.gap { flex: 1; }
.time { margin-left: 8px; font-variant-numeric: tabular-nums; letter-spacing: 0.01em; white-space: nowrap; }
.time span { color: rgb(255 255 255 / 0.55); }

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
  color: inherit;
  font: inherit;
  cursor: pointer;
  transition: background 0.15s ease;
}
button:hover { background: rgb(255 255 255 / 0.12); }
button:active { background: rgb(255 255 255 / 0.2); }
:focus-visible { outline: 2px solid #8ab4ff; outline-offset: 2px; }
svg { width: 20px; height: 20px; fill: none; stroke: currentColor; stroke-width: 1.75; stroke-linecap: round; stroke-linejoin: round; }
svg .solid { fill: currentColor; }

.seek {
  --played: 0%;
  --ahead: linear-gradient(transparent, transparent);
  display: block;
  width: 100%;
  height: 20px;
  margin: 0;
  background: none;
  appearance: none;
  cursor: pointer;
  border-radius: 6px;
}
.seek::-webkit-slider-runnable-track {
  height: 3px;
  border-radius: 2px;
  background: linear-gradient(to right, #fff var(--played), transparent var(--played)), var(--ahead), rgb(255 255 255 / 0.22);
  transition: height 0.12s ease;
}
.seek::-moz-range-track {
  height: 3px;
  border-radius: 2px;
  background: linear-gradient(to right, #fff var(--played), transparent var(--played)), var(--ahead), rgb(255 255 255 / 0.22);
}
.seek::-webkit-slider-thumb {
  width: 13px;
  height: 13px;
  margin-top: -5px;
  border: 0;
  border-radius: 50%;
  background: #fff;
  box-shadow: 0 1px 4px rgb(0 0 0 / 0.5);
  appearance: none;
  transform: scale(0);
  transition: transform 0.12s ease;
}
.seek::-moz-range-thumb { width: 13px; height: 13px; border: 0; border-radius: 50%; background: #fff; }
.seek:hover::-webkit-slider-runnable-track, .seek:focus-visible::-webkit-slider-runnable-track { height: 5px; }
.seek:hover::-webkit-slider-thumb, .seek:focus-visible::-webkit-slider-thumb, .seek:active::-webkit-slider-thumb { transform: scale(1); margin-top: -4px; }
@media (hover: none) { .seek::-webkit-slider-thumb { transform: scale(1); } }

.center { position: absolute; inset: 0; display: grid; place-items: center; pointer-events: none; padding: 24px; }
.spinner {
  width: 44px;
  height: 44px;
  border: 3px solid rgb(255 255 255 / 0.16);
  border-top-color: #fff;
  border-radius: 50%;
  opacity: 0;
  animation: turn 0.9s linear infinite, appear 0.2s ease 0.25s forwards;
}
@keyframes turn { to { rotate: 1turn; } }
@keyframes appear { to { opacity: 1; } }
.panel {
  pointer-events: auto;
  max-width: min(420px, 100%);
  padding: 24px;
  border: 1px solid rgb(255 255 255 / 0.1);
  border-radius: 16px;
  background: rgb(22 22 24 / 0.92);
  backdrop-filter: blur(12px);
  text-align: center;
}
.panel h2 { margin: 0 0 6px; font-size: 16px; font-weight: 600; }
.panel p { margin: 0 0 18px; color: rgb(255 255 255 / 0.7); font-weight: 400; overflow-wrap: anywhere; max-height: 40vh; overflow: auto; }
.panel button { width: auto; height: 38px; padding: 0 20px; background: #fff; color: #111; font-weight: 600; }
.panel button:hover { background: #dcdce0; }
.start { pointer-events: auto; width: 72px; height: 72px; border-radius: 50%; background: rgb(20 20 22 / 0.62); backdrop-filter: blur(8px); }
.start:hover { background: rgb(40 40 44 / 0.72); }
.start svg { width: 30px; height: 30px; }

@container (max-width: 400px) {
  .bar { padding-left: 8px; padding-right: 8px; }
  .time { margin-left: 2px; }
  button { width: 38px; }
}
@media (prefers-reduced-motion: reduce) {
  .bar, .seek, button { transition: none; }
  .spinner { animation-duration: 2.4s, 0.01s; }
}
`;var D=s=>`<svg viewBox="0 0 24 24" aria-hidden="true">${s}</svg>`,ee=D('<path class="solid" d="M8 5.5v13l10.5-6.5z"/>'),We=D('<path d="M8.5 5.5v13M15.5 5.5v13" stroke-width="3"/>'),Ge=D('<path d="M4 12a8 8 0 1 0 2.6-5.9L4 8.5M4 4v4.5h4.5"/>'),Re=D('<path d="M9 4H4v5M15 4h5v5M9 20H4v-5M15 20h5v-5"/>'),Be=D('<path d="M4 9h5V4M20 9h-5V4M4 15h5v5M20 15h-5v5"/>'),qe=`
  <div class="center">
    <div class="spinner" role="status" aria-label="Loading"></div>
    <button class="start" type="button" aria-label="Play" tabindex="-1" hidden>${ee}</button>
    <div class="panel" role="alert" hidden><h2>This reel cannot be played</h2><p></p><button type="button" class="retry">Try again</button></div>
  </div>
  <div class="bar" role="group" aria-label="Player controls">
    <input class="seek" type="range" min="0" max="0" step="0.001" value="0" aria-label="Seek" />
    <div class="row">
      <button type="button" class="play" aria-label="Play">${ee}</button>
      <div class="time" aria-hidden="true">0:00 <span>/ 0:00</span></div>
      <div class="gap"></div>
      <button type="button" class="reset" aria-label="Reset view" title="Reset view (r)">${Ge}</button>
      <button type="button" class="full" aria-label="Fullscreen" title="Fullscreen (f)">${Re}</button>
    </div>
  </div>`,X=class{constructor(t,e,r){this.host=t;this.player=r;let i=document.createElement("div");i.innerHTML=qe,e.append(...i.children);let n=o=>e.querySelector(o);this.bar=n(".bar"),this.seek=n(".seek"),this.time=n(".time"),this.spinner=n(".spinner"),this.panel=n(".panel"),this.start=n(".start"),this.playButton=n(".play"),this.fullButton=n(".full"),this.playButton.onclick=()=>this.toggle(),this.start.onclick=()=>this.toggle(),this.fullButton.onclick=()=>this.toggleFullscreen(),n(".reset").onclick=()=>this.resetView(),n(".retry").onclick=()=>{r.retry(),this.update()},this.listen(),this.update()}host;player;bar;seek;time;spinner;panel;start;playButton;fullButton;fade=0;dragging=!1;listen(){let{player:t,host:e,seek:r}=this,i=["loadedmetadata","canplay","play","pause","timeupdate","progress","waiting","playing","seeked","ended","error"];for(let n of i)t.addEventListener(n,()=>this.update());r.addEventListener("input",()=>{this.dragging=!0,t.currentTime=Number(r.value)}),r.addEventListener("change",()=>this.dragging=!1),e.addEventListener("keydown",n=>this.key(n));for(let n of["pointermove","pointerdown","keydown","focusin"])e.addEventListener(n,()=>this.wake());e.addEventListener("pointerleave",()=>this.sleep()),document.addEventListener("fullscreenchange",()=>this.update())}toggle(){this.player.paused?this.player.play():this.player.pause()}toggleFullscreen(){document.fullscreenElement?document.exitFullscreen():this.host.requestFullscreen?.()}resetView(){this.player.camera?.reset(),this.player.invalidate()}key(t){if(t.ctrlKey||t.metaKey||t.altKey)return;let e=t.composedPath()[0];if(t.key===" "&&e instanceof HTMLButtonElement)return;let{player:r}=this,n={" ":()=>this.toggle(),k:()=>this.toggle(),ArrowLeft:()=>r.currentTime-=1,ArrowRight:()=>r.currentTime+=1,Home:()=>r.currentTime=0,End:()=>r.currentTime=r.duration,f:()=>this.toggleFullscreen(),r:()=>this.resetView()}[t.key];n&&(t.preventDefault(),n())}wake(){this.host.classList.remove("idle"),clearTimeout(this.fade),this.fade=window.setTimeout(()=>this.sleep(),2600)}sleep(){let t=this.player.paused||this.player.error||this.dragging||this.bar.matches(":has(:focus-visible)");this.host.classList.toggle("idle",!t)}update(){let{player:t,seek:e}=this,{duration:r,currentTime:i,paused:n,error:o}=t,a=t.manifest!==null;this.bar.hidden=!a,this.panel.hidden=!o,o&&(this.panel.querySelector("p").textContent=o.message),this.spinner.hidden=o!==null||t.canPlay&&!t.waiting,this.start.hidden=!(t.canPlay&&n&&i===0&&!o&&this.spinner.hidden),e.max=String(r),this.dragging||(e.value=String(i)),e.setAttribute("aria-valuetext",`${H(i)} of ${H(r)}`),e.style.setProperty("--played",`${Q(i,r)}%`),e.style.setProperty("--ahead",this.bufferedTrack()),this.time.innerHTML=`${H(i)} <span>/ ${H(r)}</span>`,Te(this.playButton,n?ee:We,n?"Play":"Pause");let l=document.fullscreenElement!==null;Te(this.fullButton,l?Be:Re,l?"Leave fullscreen":"Fullscreen"),n||o?this.host.classList.remove("idle"):this.fade||this.wake()}bufferedTrack(){let{buffered:t,duration:e}=this.player,r=t.flatMap(([i,n])=>{let[o,a]=[Q(i,e),Q(n,e)];return[`transparent ${o}%`,`rgb(255 255 255 / 0.32) ${o}%`,`rgb(255 255 255 / 0.32) ${a}%`,`transparent ${a}%`]});return r.length>0?`linear-gradient(to right, ${r.join(", ")})`:"linear-gradient(transparent, transparent)"}};function Te(s,t,e){s.getAttribute("aria-label")!==e&&(s.innerHTML=t,s.setAttribute("aria-label",e))}function Q(s,t){return t>0?Math.round(1e4*s/t)/100:0}function H(s){let t=Math.floor(s+1e-6);return`${Math.floor(t/60)}:${String(t%60).padStart(2,"0")}`}var j=class extends HTMLElement{static observedAttributes=["src","loop"];current=null;detach=null;resize=null;get player(){return this.current}connectedCallback(){let t=this.shadowRoot??this.attachShadow({mode:"open"}),e=document.createElement("style");e.textContent=Ee;let r=document.createElement("canvas");r.tabIndex=0,r.setAttribute("role","img"),r.setAttribute("aria-label","Volumetric video. Drag to look around, scroll to zoom."),t.replaceChildren(e,r);let i=new F(r);this.current=i,i.loop=this.hasAttribute("loop"),this.hasAttribute("controls")&&new X(this,t,i);let n=()=>i.camera?.view(r.clientWidth,r.clientHeight).fx??1;this.detach=ne(r,()=>i.camera,n,()=>i.invalidate()),this.resize=new ResizeObserver(()=>i.invalidate()),this.resize.observe(r),this.open()}disconnectedCallback(){this.detach?.(),this.resize?.disconnect(),this.current?.destroy(),this.current=null}attributeChangedCallback(t){this.current&&(t==="loop"&&(this.current.loop=this.hasAttribute("loop")),t==="src"&&this.open())}open(){let t=this.getAttribute("src");if(!t||!this.current)return;this.current.load(t);let e=matchMedia("(prefers-reduced-motion: reduce)").matches;this.hasAttribute("autoplay")&&!e&&this.current.play()}};customElements.get("splat-reel")||customElements.define("splat-reel",j);var ke=document.querySelector("main[data-splatreel-page]");if(ke){let s=new URLSearchParams(location.search),t=document.createElement("splat-reel");for(let e of["autoplay","loop","controls"])s.get(e)!=="0"&&t.setAttribute(e,"");t.setAttribute("src",s.get("src")??"reel/manifest.json"),ke.append(t)}export{F as Player,j as SplatReelElement};
